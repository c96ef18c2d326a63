"""Stage `embed`: speech features of every sound, aligned to motion frames.

Run: python -m pipelines.embed

Reads: the corpus. Writes: data/embed/speech/<shard>/<sound>.npy, float32 (T, C), one per sound (shared by its takes),
and data/embed/embedding.json: fps, settings, names of the channels, their mean and standard deviation over the train
split.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.encoder import EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.orchestration.run import Report, Workspace, main, parallel_map

MIN_STD = 1e-5  # lower bound, for constant channels


@dataclass(frozen=True)
class ChannelSums:
    """Number of frames of a set of sounds, and sums of each channel and of its square."""

    frames: int
    sums: Float[ndarray, " C"]
    squares: Float[ndarray, " C"]


def run(workspace: Workspace) -> Report:
    """Embed every sound once. Statistics are summed in index order, so they do not depend on the number of jobs."""
    settings = workspace.settings("embed", EmbedSettings)
    clips = list({clip.sound: clip for clip in Corpus(workspace.corpus).clips}.values())
    fps = common_frame_rate(clips)
    channels = cached_encoder(settings).channels
    with workspace.output("embed") as folder:
        embed = partial(embed_sound, workspace.corpus, settings, folder)
        sums_by_sound = parallel_map(embed, clips, workspace.jobs, "embed")
        total = merge_sums(part for clip, part in zip(clips, sums_by_sound, strict=True) if clip.split == "train")
        mean = total.sums / total.frames
        std = np.sqrt(np.maximum(total.squares / total.frames - mean**2, MIN_STD**2))
        content = {
            "fps": fps,
            "settings": settings.model_dump(mode="json"),
            "channels": channels,
            "mean": mean.tolist(),
            "std": std.tolist(),
        }
        (folder / "embedding.json").write_text(json.dumps(content, indent=1))
    return Report(
        metrics={"sounds": float(len(clips)), "channels": float(len(channels)), "train_frames": float(total.frames)}
    )


def embed_sound(corpus: Path, settings: EmbedSettings, folder: Path, clip: Clip) -> ChannelSums:
    """Write the features of a clip's sound. Returns their sums."""
    features = cached_encoder(settings)(Corpus(corpus).speech(clip), clip.fps)
    np.save(make_shard_path(folder / "speech", clip.sound, ".npy"), features, allow_pickle=False)
    exact = features.astype(np.float64)
    return ChannelSums(len(exact), exact.sum(axis=0), np.square(exact).sum(axis=0))


@lru_cache(maxsize=1)
def cached_encoder(settings: EmbedSettings) -> SpeechEncoder:
    """The encoder, loaded once per process."""
    return make_encoder(settings)


def common_frame_rate(clips: list[Clip]) -> float:
    """The frame rate of all clips. Raises InputError if there is none, or more than one."""
    rates = sorted({clip.fps for clip in clips})
    if len(rates) != 1:
        raise InputError(f"embed: the corpus should have clips with a single frame rate, got {rates or 'none'}")
    return rates[0]


def merge_sums(parts: Iterable[ChannelSums]) -> ChannelSums:
    """Merge sums over sounds. Raises InputError if there are none."""
    total: ChannelSums | None = None
    for part in parts:
        total = (
            part
            if total is None
            else ChannelSums(total.frames + part.frames, total.sums + part.sums, total.squares + part.squares)
        )
    if total is None:
        raise InputError("embed: the corpus should have clips in the split train, got none")
    return total


if __name__ == "__main__":
    main(run)
