"""`talkingeyes pack`: pack trained models into one file, which another machine loads without conf/.

Reads folders of the train stage; writes one safetensors file (format: animation/model_file.py) atomically. It does not
contain the weights of the speech encoder, which come from a package or a hub; it stores the encoder's identity.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from talkingeyes.animation.model_file import METADATA_KEY, SCHEMA, SUFFIX, encoder_identity, find_face_model
from talkingeyes.core.atomic_file import atomic_write, writing
from talkingeyes.core.containers import parse_json
from talkingeyes.core.errors import InputError
from talkingeyes.workflows.render import check_output_file

NOT_PACKED = ("SHA256SUMS", "history.json")  # checksums of the folder and history of the training


@dataclass(frozen=True)
class PackedModel:
    """Result of packing: the models, the file size, and notes for users of the file."""

    models: tuple[str, ...]
    size_bytes: int
    notes: tuple[str, ...]


def pack(
    models: Path | str | Sequence[Path | str],
    out: Path | str,
    *,
    face: bool = True,
    half_precision: bool = False,
    force: bool = False,
) -> PackedModel:
    """Pack trained models into one file; `--model FILE` uses the first, others are stored beside it.

    A single model is packed with the face model beside its folder, if there is one and `face` is true.
    `half_precision` stores the matrices of weights in 16 bits.

    Raises InputError (one line) for a folder without a trained model.
    """
    from safetensors.numpy import save

    target = check_output_file(Path(out), SUFFIX, force)
    folders = [Path(each) for each in ([models] if isinstance(models, str | Path) else models)]
    if face and len(folders) == 1 and (beside := find_face_model(folders[0])):
        folders.append(beside)  # `animate` loads it from there, too
    names = [folder.absolute().name for folder in folders]  # not of what links of a result store point to
    if not names or len(set(names)) < len(names):
        raise InputError(f"models: should be folders of different names, got {', '.join(names) or 'none'}")
    tensors: dict[str, ndarray] = {}
    files: dict[str, str] = {}
    for name, folder in zip(names, folders, strict=True):
        _check(folder)
        for path in sorted(folder.iterdir()):
            if path.suffix == SUFFIX:
                tensors |= {f"{name}/{path.name}:{key}": value for key, value in _tensors(path, half_precision).items()}
            elif path.is_file() and path.name not in NOT_PACKED and not path.name.startswith("."):
                files[f"{name}/{path.name}"] = _text(path)
    encoder = _identity(folders[0], files[f"{names[0]}/embedding.json"])
    said = {"schema": SCHEMA, "models": names, "files": files, "encoder": encoder}
    metadata = {METADATA_KEY: json.dumps(said, sort_keys=True)}
    with writing(out), atomic_write(target) as partial:
        partial.write_bytes(save(tensors, metadata))
    return PackedModel(tuple(names), target.stat().st_size, _notes(encoder))


def _check(folder: Path) -> None:
    needed = ("config.json", "embedding.json", f"model{SUFFIX}")
    missing = [name for name in needed if not (folder / name).is_file()]
    if missing:
        raise InputError(
            f"{folder}: should be a trained model, a folder of the train stage, got one without {missing[0]}"
        )


def _tensors(path: Path, half_precision: bool) -> dict[str, ndarray]:
    import safetensors
    from safetensors.numpy import load_file

    try:
        tensors: dict[str, ndarray] = load_file(path)
    except (OSError, ValueError, safetensors.SafetensorError) as error:
        raise InputError(f"{path}: not a readable file of weights ({error}); `make repro` recreates it") from None
    if not half_precision:
        return tensors
    # Vectors (biases, statistics of the data) are small and keep their precision.
    return {
        key: each.astype(np.half) if each.dtype.kind == "f" and each.ndim > 1 else each for key, each in tensors.items()
    }


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, ValueError):
        raise InputError(f"{path}: should be a text or safetensors file of a model, got another file") from None


def _identity(folder: Path, embedding: str) -> dict[str, Any]:
    try:
        return encoder_identity(parse_json(embedding))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder / 'embedding.json'}: not the embedding of a trained model ({error!r})") from None


def _notes(encoder: dict[str, Any]) -> tuple[str, ...]:
    checkpoint = encoder["settings"]["encoder"].get("checkpoint")
    if checkpoint is None:
        return ()
    return (f"the speech encoder {checkpoint} must be available under this name on the other machine",)
