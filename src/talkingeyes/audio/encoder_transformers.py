"""wav2vec 2.0 (Baevski et al. 2020) and HuBERT (Hsu et al. 2021) through transformers: the paper's speech encoder.

The checkpoint is a local folder or a hub name. With HF_HUB_OFFLINE=1, and for packed models, only local files are used.
"""

from __future__ import annotations

from contextvars import ContextVar
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.audio.windows import FrameGrid, encode_in_windows
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import ComponentSettings

# Whether a hub may be asked; not for the checkpoint that a packed model names (animation/model_file.py).
LOCAL_FILES_ONLY: ContextVar[bool] = ContextVar("local_files_only", default=False)


class TransformersSettings(ComponentSettings):
    """A pretrained checkpoint and the transformer layer used as features."""

    kind: Literal["wav2vec2", "hubert"]
    checkpoint: Annotated[str, Field(min_length=1)]  # a local folder or a hub name
    layer: Annotated[int, Field(ge=1)]  # 1 is the first transformer layer
    window_s: Annotated[float, Field(ge=6, le=30)]
    overlap_s: Annotated[float, Field(ge=0, le=5)]


class TransformersEncoder:
    """A frozen model on the CPU."""

    settings_class = TransformersSettings

    def __init__(self, settings: TransformersSettings) -> None:
        self._model = _load(settings)
        config = self._model.config
        self._stride = FrameGrid.of_convolutions(tuple(config.conv_kernel), tuple(config.conv_stride))
        self._settings = settings
        self.channels = tuple(f"{settings.kind}_{index}" for index in range(config.hidden_size))

    def __call__(self, sound: Float[ndarray, " N"], fps: float) -> Float[ndarray, "T C"]:
        """Features at the times t / fps."""
        settings = self._settings
        return encode_in_windows(sound, fps, self._encode, self._stride, settings.window_s, settings.overlap_s)

    def _encode(self, sound: Float[ndarray, " W"]) -> Float[ndarray, "K C"]:
        import torch

        # Zero mean and unit variance, as in the feature extractor of every released checkpoint.
        normal = (sound - sound.mean()) / np.sqrt(sound.var() + 1e-7)
        with torch.inference_mode():
            output = self._model(torch.from_numpy(normal[None].astype(np.float32)), output_hidden_states=True)
        return np.asarray(output.hidden_states[self._settings.layer][0].numpy())


def _load(settings: TransformersSettings) -> Any:
    try:
        from transformers import AutoConfig, AutoModel
    except ImportError:
        raise InputError(
            f"embed.encoder.kind: {settings.kind} needs the package transformers, got none installed"
        ) from None
    local = LOCAL_FILES_ONLY.get()
    try:
        config = AutoConfig.from_pretrained(settings.checkpoint, local_files_only=local)
        if config.model_type != settings.kind:
            raise InputError(f"embed.encoder.checkpoint: should be a {settings.kind} model, got {config.model_type}")
        model = AutoModel.from_pretrained(settings.checkpoint, config=config, local_files_only=local)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        known = "a downloaded checkpoint" if local else "a hub name that can be reached"
        raise InputError(
            f"embed.encoder.checkpoint: should be a local folder or {known}, got {settings.checkpoint!r} ({error})"
        ) from None
    if settings.layer > config.num_hidden_layers:
        raise InputError(f"embed.encoder.layer: should be at most {config.num_hidden_layers}, got {settings.layer}")
    return model.eval()
