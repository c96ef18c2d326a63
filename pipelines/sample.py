"""Stage `sample`: sample S motions of every test and unseen sound with one model.

Run: python -m pipelines.sample talkingeyes

Reads: the corpus index, data/embed, data/train/<model>; the sound, for a model with a waveform encoder. A model that
takes the speaker is given that of the clip (unseen speakers are replaced by a random training speaker per sound).

Writes: data/sample/<model>/<shard>/<clip>.npz.
"""

from collections.abc import Iterable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples, Samples, SampleSettings
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.models.face.style import StyleKey
from talkingeyes.orchestration.run import Report, Workspace, main, parallel_map
from talkingeyes.training.conditioning import ConditioningPaths, ConditioningProvider
from talkingeyes.training.face_generators import TrainedFaceGenerator, load_face_generator
from talkingeyes.training.model_folder import is_face_model
from talkingeyes.training.motion_generators import (
    Speech,
    TrainedGenerator,
    load_generator,
    required_inputs,
    training_speakers,
)

BATCH_CLIPS = 16


def run(workspace: Workspace, name: str) -> Report:
    """Sample in parallel over batches of clips; each clip has its own seeds, so batches and jobs do not matter."""
    settings = workspace.settings("sample", SampleSettings)
    clips = Corpus(workspace.corpus).select("test", "unseen", take=0)
    clips = sorted(clips, key=lambda clip: clip.seconds)  # in a batch, all are padded to the longest
    batches = [clips[first : first + BATCH_CLIPS] for first in range(0, len(clips), BATCH_CLIPS)]
    with workspace.output("sample", name) as folder:
        conditioning_paths = ConditioningPaths(Corpus(workspace.corpus), workspace.data("embed"))
        task = partial(_sample, workspace.data("train", name), conditioning_paths, folder, settings)
        frames = sum(parallel_map(task, batches, workspace.jobs, f"sample {name}"))
    return Report(metrics={"clips": float(len(clips)), "frames": float(frames)})


@lru_cache(maxsize=1)
def _generator(folder: Path) -> TrainedGenerator | TrainedFaceGenerator:
    """The generator, loaded once per process."""
    return load_face_generator(folder) if is_face_model(folder) else load_generator(folder)


def _sample(
    model: Path, conditioning_paths: ConditioningPaths, folder: Path, settings: SampleSettings, clips: Sequence[Clip]
) -> int:
    embeddings = [np.load(shard_path(conditioning_paths.embed / "speech", clip.sound, ".npy")) for clip in clips]
    seeds = [
        np.random.default_rng([settings.seed, *clip.id.encode()]).integers(2**31, size=settings.samples).tolist()
        for clip in clips
    ]
    generator, fps = _generator(model), [clip.fps for clip in clips]
    found: Iterable[Samples | FaceSamples]
    if isinstance(generator, TrainedFaceGenerator):
        styles = [[StyleKey(0.0, generator.vocabulary.style_of(clip))] for clip in clips]
        found = map(generator.generate, embeddings, styles, seeds, fps)
    else:
        needed, speakers = required_inputs(generator), training_speakers(generator)
        provider = ConditioningProvider(needed, speakers, conditioning_paths)
        inputs = [provider.clip_inputs(clip, len(each)) for clip, each in zip(clips, embeddings, strict=True)]
        found = generator.generate_batch(list(map(Speech, embeddings, seeds, fps, inputs)))
    for clip, samples in zip(clips, found, strict=True):
        samples.save(make_shard_path(folder, clip.id, ".npz"))
    return settings.samples * sum(map(len, embeddings))


if __name__ == "__main__":
    main(run)
