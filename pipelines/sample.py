"""Stage `sample`: sample S motions of every test and unseen sound with one model.

Run: python -m pipelines.sample talkingeyes

Reads: the corpus index, data/embed, data/train/<model>; the sound, for a model with a waveform encoder. A model that
takes the speaker is given that of the clip (unseen speakers are replaced by a random training speaker per sound), a
model with partner conditioning the partner's speech; no reference clip is given.

Writes: data/sample/<model>/<shard>/<clip>.npz.
"""

from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import SampleSettings
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.models.condition.conditioner import NO_CONDITIONING
from talkingeyes.models.face.style import StyleKey
from talkingeyes.orchestration.run import Report, Workspace, main, parallel_map
from talkingeyes.training.conditioning import ConditioningPaths, ConditioningProvider
from talkingeyes.training.face_generators import TrainedFaceGenerator, load_face_generator
from talkingeyes.training.model_folder import is_face_model
from talkingeyes.training.motion_generators import TrainedGenerator, load_generator, required_inputs, training_speakers


def run(workspace: Workspace, name: str) -> Report:
    """Sample in parallel over clips; each clip has its own seeds, so order and number of jobs do not matter."""
    settings = workspace.settings("sample", SampleSettings)
    clips = Corpus(workspace.corpus).select("test", "unseen", take=0)
    with workspace.output("sample", name) as folder:
        conditioning_paths = ConditioningPaths(Corpus(workspace.corpus), workspace.data("embed"))
        task = partial(_sample, workspace.data("train", name), conditioning_paths, folder, settings)
        frames = sum(parallel_map(task, clips, workspace.jobs, f"sample {name}"))
    return Report(metrics={"clips": float(len(clips)), "frames": float(frames)})


@lru_cache(maxsize=1)
def _generator(folder: Path) -> TrainedGenerator | TrainedFaceGenerator:
    """The generator, loaded once per process."""
    return load_face_generator(folder) if is_face_model(folder) else load_generator(folder)


@lru_cache(maxsize=1)
def _conditioning_provider(model: Path, conditioning_paths: ConditioningPaths) -> ConditioningProvider | None:
    """The provider of conditioning inputs, if the model needs any."""
    generator = _generator(model)
    if isinstance(generator, TrainedFaceGenerator) or not required_inputs(generator):
        return None
    return ConditioningProvider(required_inputs(generator), training_speakers(generator), (), conditioning_paths)


def _sample(
    model: Path, conditioning_paths: ConditioningPaths, folder: Path, settings: SampleSettings, clip: Clip
) -> int:
    embedding = np.load(shard_path(conditioning_paths.embed / "speech", clip.sound, ".npy"))
    entropy = [settings.seed, *clip.id.encode()]
    seeds = np.random.default_rng(entropy).integers(2**31, size=settings.samples).tolist()
    generator, path = _generator(model), make_shard_path(folder, clip.id, ".npz")
    if isinstance(generator, TrainedFaceGenerator):
        style = [StyleKey(0.0, generator.vocabulary.style_of(clip))]
        generator.generate(embedding, style, seeds, clip.fps).save(path)
    else:
        conditioning_provider = _conditioning_provider(model, conditioning_paths)
        conditioning = (
            conditioning_provider.clip_inputs(clip, len(embedding)) if conditioning_provider else NO_CONDITIONING
        )
        generator.generate(embedding, seeds, clip.fps, conditioning).save(path)
    return settings.samples * len(embedding)


if __name__ == "__main__":
    main(run)
