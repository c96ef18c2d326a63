"""Sample S motions of every test and unseen sound with one model.

Run: python -m pipelines.sample talkingeyes
Reads: the corpus index, data/embed, data/train/<model>; the sound, for a model that hears the waveform. A model that
knows speakers is told who speaks (whom it does not know is one of them, drawn for each sound), one that hears the
partner what the partner says; no reference is given.
Writes: data/sample/<model>/<shard>/<clip>.npz.
"""

from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import SampleSettings
from talkingeyes.corpus.store import Corpus, sharded, sharded_for_writing
from talkingeyes.models.condition.conditioner import NOTHING
from talkingeyes.models.face.style import StyleKey
from talkingeyes.orchestration.run import Report, Workspace, each, main
from talkingeyes.training.face_trained import FaceGenerator, gives_face, load_face_generator
from talkingeyes.training.telling import Beside, Teller
from talkingeyes.training.trained import Generator, load_generator, needs, speakers_of


def run(workspace: Workspace, name: str) -> Report:
    """Clip-parallel; every clip's seeds are its own, so the order and number of jobs do not matter."""
    settings = workspace.settings("sample", SampleSettings)
    clips = Corpus(workspace.corpus).select("test", "unseen", take=0)
    with workspace.output("sample", name) as folder:
        beside = Beside(Corpus(workspace.corpus), workspace.data("embed"))
        task = partial(_sample, workspace.data("train", name), beside, folder, settings)
        frames = sum(each(task, clips, workspace.jobs, f"sample {name}"))
    return Report(metrics={"clips": len(clips), "frames": frames})


@lru_cache(maxsize=1)
def _generator(folder: Path) -> Generator | FaceGenerator:
    """Loaded once a process."""
    return load_face_generator(folder) if gives_face(folder) else load_generator(folder)


@lru_cache(maxsize=1)
def _teller(model: Path, beside: Beside) -> Teller | None:
    """What says what else the model is told, if it is told anything."""
    generator = _generator(model)
    if isinstance(generator, FaceGenerator) or not needs(generator):
        return None
    return Teller(needs(generator), speakers_of(generator), (), beside)


def _sample(model: Path, beside: Beside, folder: Path, settings: SampleSettings, clip: Clip) -> int:
    embedding = np.load(sharded(beside.embed / "speech", clip.sound, ".npy"))
    entropy = [settings.seed, *clip.id.encode()]
    seeds = np.random.default_rng(entropy).integers(2**31, size=settings.samples).tolist()
    generator, path = _generator(model), sharded_for_writing(folder, clip.id, ".npz")
    if isinstance(generator, FaceGenerator):
        style = [StyleKey(0.0, generator.vocabulary.style_of(clip))]
        generator.generate(embedding, style, seeds, clip.fps).save(path)
    else:
        teller = _teller(model, beside)
        given = teller.whole(clip, len(embedding)) if teller else NOTHING
        generator.generate(embedding, seeds, clip.fps, given).save(path)
    return settings.samples * len(embedding)


if __name__ == "__main__":
    main(run)
