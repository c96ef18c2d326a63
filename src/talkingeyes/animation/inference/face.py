"""The default model of the face in numpy: `SpeechToFace` (models/speech_to_face.py) with latents of a VQ-VAE.

Samples equal those of the torch model up to rounding (tests/test_inference.py). Other models of the face need torch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.special import erfc

from talkingeyes.animation.inference.checkpoint import NumpyCheckpoint, bounded
from talkingeyes.animation.inference.networks import SpeechProjection, WindowTransformer
from talkingeyes.animation.inference.torch_random import BLOCK, normal
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.models.face.basis import JAW_DIM, FaceBasis
from talkingeyes.models.face.style import FaceStyle, StyleKey, StyleVocabulary
from talkingeyes.models.layers.numpy_layers import NumpyLinear

TOKENIZER = "face.tokenizer.encoder_decoder"


def can_generate_face(config: Mapping[str, Any]) -> bool:
    """Whether a model has only components that exist in numpy."""
    if config["model"]["kind"] != "speech_to_face" or config["model"]["face"]["kind"] != "latent":
        return False
    network = config["tokenizer"]["network"]
    return bool(
        network["kind"] == "vq" and network["layout"] == "frames" and network["quantiser"]["kind"] == "codebook"
    )


class NumpyFaceGenerator:
    """A trained model of the face."""

    def __init__(self, checkpoint: NumpyCheckpoint) -> None:
        """Generates two frames: a damaged checkpoint raises KeyError, TypeError, ValueError, IndexError or
        ArithmeticError."""
        config, tensors = checkpoint.config, checkpoint.tensors
        face, network = config["model"]["face"], config["tokenizer"]["network"]
        self.basis, self.vocabulary = FaceBasis.of(config["basis"]), StyleVocabulary(tuple(config["speakers"]))
        self._tensors, self._speech = tensors, SpeechProjection(tensors, config["model"]["speech"])
        self._style = NumpyLinear(tensors, "style") if "style.weight" in tensors else None
        self._transformer = WindowTransformer(tensors, "face.transformer", face["transformer"])
        self._latents = NumpyLinear(tensors, "face.out")
        self._decoder = WindowTransformer(tensors, f"{TOKENIZER}.decoder", network["decoder"])
        self._out = NumpyLinear(tensors, f"{TOKENIZER}.out")
        self._correlation_frames = bounded(face["correlation_frames"])
        self._temperature = float(config["model"]["temperature"])
        style = [StyleKey(0.0, FaceStyle(None, "neutral", 0))]
        self.generate(np.zeros((2, len(tensors["speech.mean"])), np.float32), style, [0], 25.0)

    def generate(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seeds: list[int], fps: float
    ) -> FaceSamples:
        """Sample faces. Raises InputError for an unknown speaker. A seed gives the same face in any batch."""
        tensors, speech = self._tensors, self._speech(embedding)
        course = self.vocabulary.per_frame(style, len(embedding), fps)
        if self._style is not None:
            speech = speech * self._style(course[None, :, tensors["style_columns"]])
        values = self._sample_codes(self._latents(self._transformer(speech)), seeds)
        scale, mean = (tensors[f"{TOKENIZER}.normal.{name}"] for name in ("scale", "mean"))
        faces = self._out(self._decoder(values)) * scale + mean
        faces = faces.clip(tensors["min_face"], tensors["max_face"]).astype(float)
        return FaceSamples(
            fps, faces[..., -JAW_DIM:], faces[..., :-JAW_DIM], self.basis.expression_names, self.basis.head_model
        )

    def _sample_codes(self, latents: Float[ndarray, "1 T L"], seeds: list[int]) -> Float[ndarray, "S T L"]:
        """Values of codes sampled by the Gumbel-max trick (models/face/vqvae.py)."""
        tensors, temperature = self._tensors, self._temperature
        codebook = tensors["face.tokenizer.quantiser.codebook"]
        codes, width = codebook.shape
        pieces = (latents * tensors["face.tokenizer.latent_scale"]).reshape(-1, width)
        squares = np.square(pieces).sum(-1, keepdims=True) + np.square(codebook).sum(-1)
        distances = squares - 2 * pieces @ codebook.T
        shape = (len(seeds), *latents.shape[1:])
        if temperature == 0:
            return np.broadcast_to(codebook[distances.argmin(-1)].reshape(latents.shape), shape)
        logits = -distances / (np.float32(temperature) * tensors["face.tokenizer.temperature_scale"])
        frames = latents.shape[1]
        noise = (
            correlated_normal(seed, frames, len(pieces) // frames * codes, self._correlation_frames) for seed in seeds
        )
        sampled = [(logits + _normal_to_gumbel(each).reshape(logits.shape)).argmax(-1) for each in noise]
        return np.asarray(codebook[np.stack(sampled)].reshape(shape))


def correlated_normal(seed: int, frames: int, numbers: int, correlation_frames: int) -> Float[ndarray, "T N"]:
    """Noise of a Hann window over time (models/layers/correlated_noise.py)."""
    window = np.hanning(2 * correlation_frames + 1)[1:-1]
    window = (window / np.sqrt(np.square(window).sum())).astype(np.float32)
    count = (frames + len(window) - 1) * numbers
    white = normal(seed, -(-count // BLOCK) * BLOCK)[:count].reshape(-1, numbers)
    if len(window) == 1:
        return white
    slow = np.zeros((frames, numbers), np.float32)
    for start, weight in enumerate(window):
        slow += weight * white[start : start + frames]
    return slow


def _normal_to_gumbel(noise: Float[ndarray, "T N"]) -> Float[ndarray, "T N"]:
    below = (0.5 * erfc(-noise / math.sqrt(2))).clip(1e-7, 1 - 1e-7)
    return np.asarray(-np.log(-np.log(below)))
