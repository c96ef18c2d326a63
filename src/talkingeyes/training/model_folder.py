"""What a folder of the train stage holds, read without loading it."""

from __future__ import annotations

from pathlib import Path

from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError


def is_face_model(folder: Path) -> bool:
    """Whether a folder of the train stage holds a face model. Raises InputError if it holds no model."""
    try:
        return "face" in read_json(folder / "config.json", "JSON file")["model"]["parts"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        said = error if isinstance(error, InputError) else repr(error)
        raise InputError(f"{folder}: not a trained model ({said}); `make repro` trains one") from None
