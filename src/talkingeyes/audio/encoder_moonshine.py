"""The default speech encoder: Moonshine tiny (Jeffries et al. 2024, arXiv 2410.15608), with onnxruntime.

Only assets/tiny-en/encoder_model.ort of the package moonshine-voice (MIT) is used; the package is not imported. The
input is raw 16 kHz speech; convolutions (kernels 127, 7, 3, strides 64, 3, 2) give 41.67 frames per second.
"""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.audio.windows import FrameGrid, encode_in_windows
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import ComponentSettings

PACKAGE = "moonshine_voice"
MODEL = Path("assets", "tiny-en", "encoder_model.ort")
EXAMPLE_SPEECH = Path("assets", "two_cities.wav")  # a real recording of 44 s, the input of the README's example
FEATURE_SIZE = 288
STRIDE = FrameGrid.of_convolutions((127, 7, 3), (64, 3, 2))


class MoonshineSettings(ComponentSettings):
    """Windows for long sound; corpus clips should fit into one."""

    kind: Literal["moonshine"]
    window_s: Annotated[float, Field(ge=6, le=30)]
    overlap_s: Annotated[float, Field(ge=0, le=5)]


class MoonshineEncoder:
    """One onnxruntime session on one thread."""

    settings_class = MoonshineSettings

    def __init__(self, settings: MoonshineSettings) -> None:
        os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # read at the import; disable_telemetry_events comes too late
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        model = str(package_file(MODEL))
        self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        self._settings = settings
        self.channels = tuple(f"moonshine_{index}" for index in range(FEATURE_SIZE))

    def __call__(self, sound: Float[ndarray, " N"], fps: float) -> Float[ndarray, "T C"]:
        """Features at the times t / fps."""
        return encode_in_windows(sound, fps, self._encode, STRIDE, self._settings.window_s, self._settings.overlap_s)

    def _encode(self, sound: Float[ndarray, " W"]) -> Float[ndarray, "K C"]:
        inputs = {
            "input_values": sound[None].astype(np.float32, copy=False),
            "attention_mask": np.ones((1, len(sound)), np.int64),
        }
        hidden: Float[ndarray, "1 K C"] = self._session.run(["last_hidden_state"], inputs)[0]
        return np.asarray(hidden[0])


def package_file(file: Path) -> Path:
    """Path of a file in the package. Raises InputError if the package is not installed or lacks the file."""
    spec = find_spec(PACKAGE)  # finds the package without importing it
    if spec is None or not spec.submodule_search_locations:
        raise InputError("speech encoder: the package moonshine-voice should be installed (`make setup`), got none")
    path = Path(spec.submodule_search_locations[0], file)
    if not path.is_file():
        raise InputError(
            f"speech encoder: moonshine-voice should be version 0.0.73, which ships {file}; got one without it"
        )
    return path
