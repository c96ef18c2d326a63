"""A model in one file, which another machine opens without conf/: what `talkingeyes pack` writes, `--model FILE` reads.

A safetensors file, so that nothing in it can run. Its tensors are those of the folders of the train stage that it was
packed from, as FOLDER/FILE.safetensors:NAME; its metadata hold one entry, `talkingeyes`, in JSON (safetensors writes
several in an order that changes):

    schema   talkingeyes.model/1
    models   the folders, the one that `--model` means first
    files    every other file of theirs: resolved configuration, embedding, blinks, ... {FOLDER/FILE: text}
    encoder  who the speech encoder is: kind, channels, settings, and the digest of its weights where a package ships
             them; on opening, the one that is installed must be the same

Opened, it is those folders again, in a place of its own that is gone afterwards: whatever loads a folder loads a file.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from talkingeyes.core.errors import InputError

SCHEMA = "talkingeyes.model/1"
METADATA_KEY = "talkingeyes"
SUFFIX = ".safetensors"
MEMBER_PATTERN = re.compile(
    r"\w[\w.-]*/\w[\w.-]*"
)  # FOLDER/FILE: nothing that leads out of the place it is unpacked to


@dataclass(frozen=True)
class PackedMetadata:
    """The metadata of a packed model."""

    models: tuple[str, ...]
    files: Mapping[str, str]
    encoder: Mapping[str, Any]


@contextlib.contextmanager
def open_model(model: Path) -> Iterator[Path]:
    """A folder with the model: the one that was named, or that of a packed file while the block lasts.

    Raises InputError if it is neither; errors from inside the block name the file.
    """
    if model.is_dir():
        yield model
        return
    if not model.exists():
        raise InputError(f"{model}: no trained model here; run `make repro` first, or name a folder of the train stage")
    packed = read_packed_metadata(model)
    _check_encoder(model, packed.encoder)
    with tempfile.TemporaryDirectory(prefix="talkingeyes-") as place:
        first = _unpack(model, packed, Path(place))
        try:
            yield first
        except InputError as error:
            raise InputError(str(error).replace(str(first), str(model))) from None


def read_packed_metadata(path: Path) -> PackedMetadata:
    """What a packed model says of itself. Raises InputError if it is damaged or another file."""
    import safetensors

    try:
        with safetensors.safe_open(path, "np") as file:
            metadata = file.metadata() or {}
        header = json.loads(metadata.get(METADATA_KEY, "{}"))
        if header.get("schema") != SCHEMA:
            raise InputError(f"{path}: should be a model of `talkingeyes pack` ({SCHEMA}), got {header.get('schema')}")
        packed = PackedMetadata(tuple(header["models"]), dict(header["files"]), dict(header["encoder"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, safetensors.SafetensorError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: should be a folder of the train stage or a file of `talkingeyes pack`, got what cannot be read "
            f"({' '.join(str(error).split())[:120]})"
        ) from None
    if not packed.models or not all(MEMBER_PATTERN.fullmatch(f"{model}/x") for model in packed.models):
        raise InputError(f"{path}: models should be plain names, got {list(packed.models)}")
    return packed


def _unpack(path: Path, packed: PackedMetadata, place: Path) -> Path:
    """Write the folders of a packed model; gives the first."""
    from safetensors.torch import load_file, save_file

    tensors: dict[str, dict[str, Any]] = {}
    for key, tensor in load_file(path).items():
        file, _, name = key.partition(":")
        tensors.setdefault(file, {})[name] = tensor
    for name in (*packed.files, *tensors):
        if not MEMBER_PATTERN.fullmatch(name) or name.split("/")[0] not in packed.models:
            raise InputError(f"{path}: holds {name!r}, which belongs to none of its models")
    for model in packed.models:
        (place / model).mkdir()
    for name, text in packed.files.items():
        (place / name).write_text(text)
    for name, content in tensors.items():
        save_file(content, place / name)
    return place / packed.models[0]


def encoder_identity(embedding: Mapping[str, Any]) -> dict[str, Any]:
    """Who the speech encoder of an embedding is."""
    settings = embedding["settings"]
    return {
        "kind": settings["encoder"]["kind"],
        "settings": settings,
        "channels": len(embedding["channels"]),
        "weights_sha256": _weights_sha256(settings["encoder"]["kind"]),
    }


def _weights_sha256(kind: str) -> str | None:
    """The digest of weights that a package ships; None where they come from elsewhere, or there are none."""
    if kind != "moonshine":
        return None
    from talkingeyes.audio.encoder_moonshine import MODEL, package_file

    return hashlib.sha256(package_file(MODEL).read_bytes()).hexdigest()


def _check_encoder(path: Path, encoder: Mapping[str, Any]) -> None:
    wanted = encoder.get("weights_sha256")
    if wanted is not None and wanted != (found := _weights_sha256(str(encoder.get("kind")))):
        raise InputError(
            f"{path}: made with other weights of the speech encoder {encoder['kind']} than are installed "
            f"(should be {str(wanted)[:12]}, got {str(found)[:12]}): install the release that it was trained with"
        )
