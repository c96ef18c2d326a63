"""Sample S motions of every test and unseen sound with one model.

Run: python -m pipelines.sample talkingeyes
Reads: the corpus index, data/embed, data/train/<model>. Writes: data/sample/<model>/<shard>/<clip>.npz.
"""

from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import SampleSettings
from talkingeyes.corpus.store import Corpus, sharded, sharded_for_writing
from talkingeyes.learning.face_trained import FaceGenerator, gives_face, load_face_generator
from talkingeyes.learning.trained import Generator, load_generator
from talkingeyes.models.face.style import StyleKey
from talkingeyes.run import Report, Workspace, each, main


def run(workspace: Workspace, name: str) -> Report:
    """Clip-parallel; every clip's seeds are its own, so the order and number of jobs do not matter."""
    settings = workspace.settings("sample", SampleSettings)
    clips = Corpus(workspace.corpus).select("test", "unseen", take=0)
    with workspace.output("sample", name) as folder:
        task = partial(_sample, workspace.data("train", name), workspace.data("embed"), folder, settings)
        frames = sum(each(task, clips, workspace.jobs, f"sample {name}"))
    return Report(metrics={"clips": len(clips), "frames": frames})


@lru_cache(maxsize=1)
def _generator(folder: Path) -> Generator | FaceGenerator:
    """Loaded once a process."""
    return load_face_generator(folder) if gives_face(folder) else load_generator(folder)


def _sample(model: Path, embed: Path, folder: Path, settings: SampleSettings, clip: Clip) -> int:
    embedding = np.load(sharded(embed / "speech", clip.sound, ".npy"))
    entropy = [settings.seed, *clip.id.encode()]
    seeds = np.random.default_rng(entropy).integers(2**31, size=settings.samples).tolist()
    generator, path = _generator(model), sharded_for_writing(folder, clip.id, ".npz")
    if isinstance(generator, FaceGenerator):
        style = [StyleKey(0.0, generator.vocabulary.style_of(clip))]
        generator.generate(embedding, style, seeds, clip.fps).save(path)
    else:
        generator.generate(embedding, seeds, clip.fps).save(path)
    return settings.samples * len(embedding)


if __name__ == "__main__":
    main(run)
