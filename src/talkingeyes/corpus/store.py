"""File layout of a corpus. Folders are sharded by a hash of the id, so a million clips can be listed."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import soundfile
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.corpus.index import Clip, read_index, write_index
from talkingeyes.head.observation import Observation


def shard_path(folder: Path, name: str, suffix: str) -> Path:
    """folder/a/name+suffix, where a is the first digit of a hash of the name.

    Sixteen folders keep a million clips listable, and `dvc repro`, which visits every folder, fast.
    """
    return folder / hashlib.blake2b(name.encode(), digest_size=1).hexdigest()[0] / (name + suffix)


def make_shard_path(folder: Path, name: str, suffix: str) -> Path:
    """The same path, after creating its folder."""
    path = shard_path(folder, name, suffix)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _sound(path: Path) -> Float[ndarray, " N"]:
    try:
        sound, rate = soundfile.read(path, dtype="float32")
    except (OSError, soundfile.LibsndfileError) as error:
        raise InputError(f"{path}: not a readable sound ({error})") from None
    if rate != SAMPLE_RATE or sound.ndim != 1:
        raise InputError(f"{path}: corpus sound should be 16 kHz mono, got {rate} Hz, shape {sound.shape}")
    return np.asarray(sound)


@dataclass(frozen=True)
class Corpus:
    """A corpus folder, as written by `synthesize` and `track`. Sound: 16 kHz mono. `truth` exists if synthetic."""

    root: Path

    @cached_property
    def clips(self) -> list[Clip]:
        """All clips, in the order of the index."""
        return read_index(self.root / "clips.parquet")

    def select(self, *splits: str, take: int | None = None) -> list[Clip]:
        """Clips of the given splits; `take=0` excludes the further takes of a sound."""
        return [clip for clip in self.clips if clip.split in splits and (take is None or clip.take == take)]

    def speech(self, clip: Clip) -> Float[ndarray, " N"]:
        """The clip's sound, float32 at 16 kHz: the subject's voice."""
        return _sound(shard_path(self.root / "speech", clip.sound, ".flac"))

    def partner(self, clip: Clip) -> Float[ndarray, " N"] | None:
        """The partner's voice, of the same length as `speech`, or None without a partner."""
        path = shard_path(self.root / "partner", clip.sound, ".flac")
        return _sound(path) if path.exists() else None

    def annotation(self, clip: Clip) -> Annotation:
        """Words, phonemes and spans of the clip's sound."""
        return self.conversation(clip).clipped(clip.seconds)

    def conversation(self, clip: Clip) -> Annotation:
        """Those of the conversation that the sound is cut out of: also before 0 and after the end of the clip."""
        return Annotation.load(shard_path(self.root / "annotations", clip.sound, ".json"))

    def observation(self, clip: Clip) -> Observation:
        """Landmarks and pupils in pixels."""
        return Observation.load(shard_path(self.root / "observations", clip.id, ".npz"))

    @property
    def has_truth(self) -> bool:
        """Whether the true motion is known (a synthetic corpus)."""
        return (self.root / "truth").is_dir()

    def truth(self, clip: Clip) -> Motion:
        """The true motion (synthetic corpora only)."""
        return Motion.load(shard_path(self.root / "truth", clip.id, ".npz"))

    def truth_events(self, clip: Clip) -> Events:
        """The true events (synthetic corpora only)."""
        return Events.load(shard_path(self.root / "truth", clip.id, ".events.json"))

    # Writing: per sound, per clip, and finally the index, which completes the corpus.

    def write_sound(
        self,
        sound: str,
        samples: Float[ndarray, " N"],
        annotation: Annotation,
        partner: Float[ndarray, " N"] | None = None,
    ) -> None:
        """Write speech and annotation of a sound, which several takes may share, and the partner's channel if any."""
        if partner is not None:
            _write_flac(make_shard_path(self.root / "partner", sound, ".flac"), partner)
        _write_flac(make_shard_path(self.root / "speech", sound, ".flac"), samples)
        annotation.save(make_shard_path(self.root / "annotations", sound, ".json"))

    def write_clip(self, clip_id: str, observation: Observation, truth: Motion | None, events: Events | None) -> None:
        """Write the observation of a clip and, if known, the true motion and events."""
        observation.save(make_shard_path(self.root / "observations", clip_id, ".npz"))
        if truth is not None:
            truth.save(make_shard_path(self.root / "truth", clip_id, ".npz"))
        if events is not None:
            events.save(make_shard_path(self.root / "truth", clip_id, ".events.json"))

    def write_index(self, clips: list[Clip]) -> None:
        """Write clips.parquet."""
        write_index(self.root / "clips.parquet", clips)


def _write_flac(path: Path, samples: Float[ndarray, " N"]) -> None:
    file = io.BytesIO()  # libsndfile does not say why it cannot write
    soundfile.write(file, samples, SAMPLE_RATE, format="FLAC", subtype="PCM_16")
    path.write_bytes(file.getbuffer())
