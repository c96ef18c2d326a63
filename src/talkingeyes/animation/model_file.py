"""A model in one file, independent of conf/: written by `talkingeyes pack`, read by `--model FILE`.

A safetensors file, so that nothing in it can be executed. Its tensors are those of the train stage's folders that it
was packed from, named FOLDER/FILE.safetensors:NAME; its metadata hold one entry, `talkingeyes`, in JSON (safetensors
writes several entries in varying order):

    schema   talkingeyes.model/1
    models   the folders; the first is the one that `--model` means
    files    all other files of the folders (resolved configuration, embedding, blinks, ...): {FOLDER/FILE: text}
    encoder  the speech encoder: kind, channels, settings, and the digest of its weights where a package ships them;
             opening requires the same one to be installed

A packed file names only components of the registries (unless TALKINGEYES_ALLOW_PLUGINS=1), and opening it never uses
the network. It is opened as these folders in a temporary directory, so that every loader of a folder also loads a file.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from talkingeyes.audio.encoder_transformers import LOCAL_FILES_ONLY
from talkingeyes.core.atomic_file import temporary_folder
from talkingeyes.core.containers import parse_json, reading
from talkingeyes.core.errors import InputError

SCHEMA = "talkingeyes.model/1"
PACKED = "folder of the train stage or file of `talkingeyes pack`"
METADATA_KEY = "talkingeyes"
ALLOW_PLUGINS = "TALKINGEYES_ALLOW_PLUGINS"
FACE_MODEL_FOLDER = "probtalk3d"
LIVE_FACE_FOLDER = "face_live"  # the face of streams
TRAINED_MODELS = Path("data", "train")
WORKSPACE_MODEL = TRAINED_MODELS / "talkingeyes_events"
ASSETS = Path(__file__).parent / "assets"
SUFFIX = ".safetensors"
PACKAGED_MODEL = ASSETS / f"talkingeyes_events{SUFFIX}"
PACKAGED_LIVE_MODEL = ASSETS / f"talkingeyes_live{SUFFIX}"
PACKAGED_LIVE_FACE = ASSETS / f"talkingeyes_live_face{SUFFIX}"
# Trained on gaze of people in remote calls.
PACKAGED_REMOTE_CALL_MODEL = ASSETS / f"talkingeyes_remote_call{SUFFIX}"
PACKAGED_MODELS = {each.stem: each for each in (PACKAGED_MODEL, PACKAGED_LIVE_MODEL, PACKAGED_REMOTE_CALL_MODEL)}
MEMBER_PATTERN = re.compile(r"\w[\w.-]*/\w[\w.-]*")  # FOLDER/FILE: no path outside the folder it is unpacked to


@dataclass(frozen=True)
class PackedMetadata:
    """The metadata of a packed model."""

    models: tuple[str, ...]
    files: Mapping[str, str]
    encoder: Mapping[str, Any]


def find_model(model: Path | str | None) -> Path:
    """The given model (a path, else the name of a packaged one or of a trained row of the workspace), else the trained
    default of the workspace, else the packaged one."""
    if model is not None:
        path, trained = Path(model), TRAINED_MODELS / model
        if path.exists():
            return path
        return PACKAGED_MODELS.get(str(model), trained if trained.is_dir() else path)
    return WORKSPACE_MODEL if WORKSPACE_MODEL.is_dir() else PACKAGED_MODEL


def is_packaged(model: Path) -> bool:
    """Whether it is a file of this package."""
    return model.resolve() in {each.resolve() for each in PACKAGED_MODELS.values()}


def model_title(model: Path) -> str:
    """How to name a model to a user: its path, or that it is the packaged one."""
    if model == PACKAGED_MODEL:
        return "the packaged model"
    return f"the packaged {model.stem}" if is_packaged(model) else str(model)


def find_face_model(model: Path, name: str = FACE_MODEL_FOLDER) -> Path | None:
    """The folder `name` of the face model beside the folder of a model of head and gaze, if there is one."""
    # Not resolved: runs of experiments show results of a store as links.
    folder = (model if model.name not in ("", "..") else model.absolute()).parent / name
    return folder if folder.is_dir() and folder.absolute() != model.absolute() else None


def face_source(model: Path, name: str = FACE_MODEL_FOLDER, packaged: Path = PACKAGED_MODEL) -> Path:
    """Where the face `name` of a model comes from: the folder beside it, its own packed file, else the packaged one."""
    if model.is_dir():
        return find_face_model(model, name) or packaged
    return model if name in read_packed_metadata(model).models[1:] else packaged


def parts_title(model: Path) -> str:
    """Which model each part of an animation is from, for users."""
    face = face_source(model)
    if face == model:
        return f"head, gaze and face: {model_title(model)}"
    return f"head and gaze: {model_title(model)}, face: {'packaged' if face == PACKAGED_MODEL else face}"


@contextlib.contextmanager
def open_with_face(
    model: Path, name: str = FACE_MODEL_FOLDER, packaged: Path = PACKAGED_MODEL
) -> Iterator[tuple[Path, Path]]:
    """The folders of a model and of its face (`face_source`), as `open_model` opens them."""
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(open_model(model))
        source = face_source(model, name, packaged)
        opened = folder if source == model else stack.enter_context(open_model(source))
        yield folder, opened if source.is_dir() else opened.parent / name


@contextlib.contextmanager
def open_model(model: Path) -> Iterator[Path]:
    """The folder of a model: the given one, or a temporary one of a packed file while the block lasts.

    Raises InputError if it is neither; an InputError from inside the block names the packed file.
    """
    if model.is_dir():
        yield model
        return
    if not model.exists():
        raise InputError(
            f"{model}: no trained model here; run `make repro` first, or name a folder of the train stage or one of "
            f"{', '.join(PACKAGED_MODELS)}"
        )
    with temporary_folder() as place:
        with reading(model, PACKED):
            packed = read_packed_metadata(model)
            _check_content(model, packed)
            _check_encoder(model, packed.encoder)
            first = _unpack(model, packed, place)
        offline = LOCAL_FILES_ONLY.set(True)
        try:
            yield first
        except InputError as error:
            said = str(error).replace(str(first), str(model))
            raise InputError(said.replace(str(place), str(model))) from None  # of a model beside the first
        finally:
            LOCAL_FILES_ONLY.reset(offline)


def read_packed_metadata(path: Path) -> PackedMetadata:
    """Read the metadata of a packed model. Raises InputError if it is damaged or another kind of file."""
    import safetensors

    with reading(path, PACKED):
        with safetensors.safe_open(path, "np") as file:
            metadata = file.metadata() or {}
        header = parse_json(metadata.get(METADATA_KEY, "{}"))
        if header.get("schema") != SCHEMA:
            raise InputError(f"{path}: should be a model of `talkingeyes pack` ({SCHEMA}), got {header.get('schema')}")
        packed = PackedMetadata(tuple(header["models"]), dict(header["files"]), dict(header["encoder"]))
    if not packed.models or not all(MEMBER_PATTERN.fullmatch(f"{model}/x") for model in packed.models):
        raise InputError(f"{path}: models should be plain names, got {list(packed.models)}")
    return packed


def _unpack(path: Path, packed: PackedMetadata, place: Path) -> Path:
    """Write the folders of a packed model; returns the first."""
    from safetensors.numpy import load_file, save

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
        (place / name).write_bytes(save(content))
    return place / packed.models[0]


def _check_content(path: Path, packed: PackedMetadata) -> None:
    """Refuse a file that would import a module or ask a hub when it is loaded, and JSON that cannot be read."""
    for name, text in packed.files.items():
        if not name.endswith(".json"):
            continue
        try:
            nodes = list(_mappings(parse_json(text)))
        except ValueError as error:
            raise InputError(f"{path}: {name} should be JSON ({error})") from None
        for node in nodes:
            kind = node.get("kind")
            if isinstance(kind, str) and ":" in kind and os.environ.get(ALLOW_PLUGINS) != "1":
                raise InputError(
                    f"{path}: names the class {kind!r}, whose module would be run; {ALLOW_PLUGINS}=1 allows it"
                )
            # Without its architecture, the network is built from the checkpoint that the settings name.
            if not node.get("architecture") and any(
                each.get("waveform_encoder") for each in _mappings(node.get("model"))
            ):
                raise InputError(f"{path}: {name} should have the architecture of its waveform encoder, got none")


def _mappings(node: Any) -> Iterator[Mapping[str, Any]]:
    """All mappings in a JSON value."""
    if isinstance(node, Mapping):
        yield node
    children = node.values() if isinstance(node, Mapping) else node if isinstance(node, list) else ()
    for child in children:
        yield from _mappings(child)


def encoder_identity(embedding: Mapping[str, Any]) -> dict[str, Any]:
    """Kind, settings, channels and weight digest of the speech encoder of an embedding."""
    settings = embedding["settings"]
    return {
        "kind": settings["encoder"]["kind"],
        "settings": settings,
        "channels": len(embedding["channels"]),
        "weights_sha256": _weights_sha256(settings["encoder"]["kind"]),
    }


def _weights_sha256(kind: str) -> str | None:
    """SHA-256 of the weights that a package ships; None where they come from elsewhere, or there are none."""
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
