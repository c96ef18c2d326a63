"""The packaged corpus of the gaze benchmark: a corpus with its true motion in one small file.

A zip of the index, the annotations, the sounds (Opus), head, gaze and lids of every clip in steps of STEP, and the
evaluators: frozen networks, and the speech features that they read. Observations and events are left out.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import soundfile
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import output_folder
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path

PACKAGED = Path(__file__).with_name("assets") / "benchmark.zip"
STEP = 2.0**-17  # of radians and of lids: 0.0004 degrees; rounded numbers compress to half the size
FIELDS = ("head", "gaze", "lid")
EVALUATORS = "evaluators"
CORPUS_FILES = re.compile(rf"clips\.parquet|speech|partner|annotations|truth|{EVALUATORS}")


def pack_corpus(corpus: Corpus, evaluators: Path, path: Path) -> None:
    """Write a corpus with truth as one file, in the same bytes at any time. `evaluators` has the folders `critic` and
    `embed` of a pipeline."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in _members(corpus, evaluators):
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)  # dated 1980


def _members(corpus: Corpus, evaluators: Path) -> Iterator[tuple[str, bytes]]:
    yield "clips.parquet", (corpus.root / "clips.parquet").read_bytes()
    for clip in _first_takes(corpus):
        annotation = shard_path(corpus.root / "annotations", clip.sound, ".json")
        yield f"annotations/{clip.sound}.json", annotation.read_bytes()
        yield f"speech/{clip.sound}.ogg", _encoded(corpus.speech(clip))
        if (partner := corpus.partner(clip)) is not None:
            yield f"partner/{clip.sound}.ogg", _encoded(partner)
    for clip in corpus.clips:
        motion, content = corpus.truth(clip), io.BytesIO()
        arrays = {name: (np.round(getattr(motion, name) / STEP) * STEP).astype(np.float32) for name in FIELDS}
        np.savez(content, fps=motion.fps, valid=motion.valid, **arrays)
        yield f"truth/{clip.id}.npz", content.getvalue()
    for each in sorted(path for path in evaluators.rglob("*") if path.is_file()):
        yield f"{EVALUATORS}/{each.relative_to(evaluators)}", each.read_bytes()


def unpack_corpus(path: Path, folder: Path) -> Corpus:
    """Write the corpus of a packed file to a folder that is new or empty, and return it."""
    target = output_folder.output_path(folder, CORPUS_FILES, force=False)
    with output_folder.atomic_folder(target) as partial, zipfile.ZipFile(path) as archive:
        archive.extract("clips.parquet", partial)
        corpus, names = Corpus(partial), set(archive.namelist())
        for clip in _first_takes(corpus):
            annotation = make_shard_path(partial / "annotations", clip.sound, ".json")
            annotation.write_bytes(archive.read(f"annotations/{clip.sound}.json"))
            speech = _decoded(archive.read(f"speech/{clip.sound}.ogg"))
            partner = f"partner/{clip.sound}.ogg"
            both = _decoded(archive.read(partner)) if partner in names else None
            corpus.write_sound(clip.sound, speech, corpus.conversation(clip), both)
        for clip in corpus.clips:
            with np.load(io.BytesIO(archive.read(f"truth/{clip.id}.npz"))) as arrays:
                motion = Motion.of(float(arrays["fps"]), **{name: arrays[name] for name in (*FIELDS, "valid")})
            motion.save(make_shard_path(partial / "truth", clip.id, ".npz"))
        archive.extractall(partial, [name for name in names if name.startswith(f"{EVALUATORS}/")])
    return Corpus(target)


def _first_takes(corpus: Corpus) -> list[Clip]:
    """One clip of each sound."""
    return [clip for clip in corpus.clips if clip.take == 0]


def _encoded(sound: Float[ndarray, " N"]) -> bytes:
    content = io.BytesIO()
    soundfile.write(content, sound, SAMPLE_RATE, format="OGG", subtype="OPUS")
    return _with_serial_number_0(content.getvalue())


def _with_serial_number_0(ogg: bytes) -> bytes:
    """An Ogg stream, to which libsndfile gives a random serial number (pages and their checksums: RFC 3533)."""
    content, start = bytearray(ogg), 0
    while start < len(content):
        segments = content[start + 26]
        stop = start + 27 + segments + sum(content[start + 27 : start + 27 + segments])
        content[start + 14 : start + 18] = content[start + 22 : start + 26] = bytes(4)
        checksum = 0
        for byte in content[start:stop]:
            checksum = (checksum << 8 & 0xFFFFFFFF) ^ OGG_CHECKSUMS[checksum >> 24 ^ byte]
        content[start + 22 : start + 26] = checksum.to_bytes(4, "little")
        start = stop
    return bytes(content)


def _ogg_checksum(byte: int) -> int:
    checksum = byte << 24
    for _ in range(8):
        checksum = (checksum << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if checksum >> 31 else 0)
    return checksum


OGG_CHECKSUMS = tuple(map(_ogg_checksum, range(256)))


def _decoded(content: bytes) -> Float[ndarray, " N"]:
    sound, rate = soundfile.read(io.BytesIO(content), dtype="float32")
    assert rate == SAMPLE_RATE, rate
    return np.asarray(sound)
