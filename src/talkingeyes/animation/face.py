"""The face of an animation: jaw and expression from a face model (ProbTalk3D), added to head, gaze and blinks.

The model is in the folder `probtalk3d` beside that of head and gaze, in the same packed file, or else the packaged one
(`model_file.face_source`). It receives the same speech and has a random stream of its own.

Division of labour: `expression` has no channels of gaze, blinks and jaw, so the model cannot blink. Brows are its own.
Its shapes around the eyes (squint, wide) fade as the lids close, so that the lids meet in a blink. Raised and drooping
lids of an emotion are in `lid`, which the model does not output: they follow the rule of the synthetic data
(`physiology/face.py`), and a blink closes what they leave open. Between the model's frames values are interpolated
without overshoot (PCHIP), so that closed lips stay closed at any frame rate.

Speech of more than two minutes is processed in chunks that overlap by six seconds, each sampled anew (like the latent
variable of the head), with a crossfade in the middle of the overlap, where both chunks have context on both sides:
memory besides the motion itself does not grow with the speech.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import PchipInterpolator

from talkingeyes.animation.inference.face import NumpyFaceGenerator
from talkingeyes.animation.inference.loading import load_face_model
from talkingeyes.audio.encoder import EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.head.anny import anny_head
from talkingeyes.head.posing import expression_shape_names
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import FaceStyle, StyleKey, blend_over_time
from talkingeyes.physiology.face import EMOTION_EXPRESSIONS, INTENSITY_STRENGTH
from talkingeyes.training.model_folder import is_face_model

if TYPE_CHECKING:
    from talkingeyes.training.face_generators import TrainedFaceGenerator

AROUND_EYES = ("eyeSquint", "eyeWide")
CHUNK_S, OVERLAP_S, CROSSFADE_S = 120.0, 6.0, 0.5
SEED_STREAM = 4  # random stream of the face among those of a sample


@dataclass(frozen=True)
class FaceAnimator:
    """A trained face model with its speech encoder."""

    generator: NumpyFaceGenerator | TrainedFaceGenerator
    encoder: SpeechEncoder
    fps: float

    @classmethod
    def load(cls, folder: Path, settings: EmbedSettings, encoder: SpeechEncoder) -> FaceAnimator:
        """Load a folder of the train stage; `encoder` is used again if the settings agree.

        Raises InputError if it is not a model of the open head's face.
        """
        if not is_face_model(folder):
            raise InputError(f"{folder}: should be a face model, such as probtalk3d, got another model")
        head = anny_head()
        with reading(folder, "trained model; `make report` trains one"):
            generator = load_face_model(folder, FaceBasis(head.name, expression_shape_names(head)))
            content = read_json(folder / "embedding.json", "JSON file")
            own, fps = validate_section("embed", EmbedSettings, content["settings"]), float(content["fps"])
        return cls(generator, encoder if own == settings else make_encoder(own), fps)

    def check(self, style: Sequence[StyleKey]) -> None:
        """Raises InputError (one line, with the choices) for a speaker who is not a training speaker."""
        for key in style:
            self.generator.vocabulary.style_vector(key.style)

    def perform(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seed: int, samples: int
    ) -> FaceSamples:
        """Sample faces at the model's rate; sample i of a seed does not depend on the number of samples."""
        fps = self.fps
        piece, overlap = round(CHUNK_S * fps), round(OVERLAP_S * fps)
        faces = self._chunk(embedding[:piece], style, (seed, samples, 0))
        for number, start in enumerate(range(piece - overlap, len(embedding) - overlap, piece - overlap), start=1):
            later = [replace(key, onset_s=key.onset_s - start / fps) for key in style]
            following = self._chunk(embedding[start : start + piece], later, (seed, samples, number))
            faces = crossfade(faces, following, start, overlap)
        return faces

    def _chunk(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seed_parts: tuple[int, int, int]
    ) -> FaceSamples:
        """Sample one chunk; `seed_parts` are the seed, the number of samples and the number of the chunk."""
        seed, samples, number = seed_parts
        streams = [np.random.SeedSequence([seed, index, SEED_STREAM, number]) for index in range(samples)]
        return self.generator.generate(embedding, style, [int(each.generate_state(1)[0]) for each in streams], self.fps)


def crossfade(faces: FaceSamples, following: FaceSamples, start: int, overlap: int) -> FaceSamples:
    """Join two chunks, the second from frame `start` on, with a crossfade in the middle of the overlap."""
    both = min(overlap, following.jaw.shape[1])
    ramp = (np.arange(both) - (both - 1) / 2) / (CROSSFADE_S * faces.fps) + 0.5
    share = np.clip(ramp, 0.0, 1.0)[None, :, None]

    def joined(one: Float[ndarray, "S T C"], other: Float[ndarray, "S U C"]) -> Float[ndarray, "S V C"]:
        seam = (1.0 - share) * one[:, start : start + both] + share * other[:, :both]
        return np.concatenate([one[:, :start], seam, other[:, both:]], axis=1)

    return replace(
        faces,
        jaw=joined(faces.jaw, following.jaw),
        expression=joined(faces.expression, following.expression),
    )


def with_face(motion: Motion, faces: FaceSamples, sample: int, style: Sequence[StyleKey]) -> Motion:
    """Add a face to a motion whose `lid` holds blinks alone: jaw, expression, and the lid opening of the emotion."""
    times_s = np.arange(len(motion)) / motion.fps
    expression = interpolate_pchip(faces.expression[sample], faces.fps, times_s)
    return replace(
        motion,
        jaw=interpolate_pchip(faces.jaw[sample], faces.fps, times_s),
        expression=fade_around_eyes(expression, faces.expression_names, motion.lid),
        expression_names=faces.expression_names,
        head_model=faces.head_model,
        lid=with_emotion(motion.lid, emotion_lid_closure(style, times_s)),
    )


def fade_around_eyes(
    expression: Float[ndarray, "T C"], names: Sequence[str], lid: Float[ndarray, "T 2"]
) -> Float[ndarray, "T C"]:
    """An expression within 0 to 1, whose shapes around the eyes fade as blinks close the lids."""
    shown = np.clip(expression, 0.0, 1.0)
    closure = np.clip(lid.mean(axis=1), 0.0, 1.0)
    for column, name in enumerate(names):
        if name.startswith(AROUND_EYES):
            shown[:, column] *= 1.0 - closure
    return np.asarray(shown)


def with_emotion(lid: Float[ndarray, "T 2"], raised: Float[ndarray, " T"]) -> Float[ndarray, "T 2"]:
    """Lids of blinks with the closure by an emotion, of which a blink closes what it leaves open."""
    return np.asarray(lid + (1.0 - np.clip(lid, 0.0, 1.0)) * raised[:, None])


def emotion_lid_closure(style: Sequence[StyleKey], times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    """Lid closure by the emotion (below 0: opening) at each time, blended as the style is."""
    return blend_over_time(style, times_s, _lid)[:, 0]


def _lid(style: FaceStyle) -> Float[ndarray, " 1"]:
    return np.array([INTENSITY_STRENGTH[style.intensity] * EMOTION_EXPRESSIONS[style.emotion].lid])


def interpolate_pchip(
    values: Float[ndarray, "F C"], fps: float, times_s: Float[ndarray, " T"]
) -> Float[ndarray, "T C"]:
    """Interpolate without overshoot; after the last frame its values are held."""
    if len(values) < 2 or not values.shape[1]:
        return np.repeat(values[:1], len(times_s), axis=0)
    last_s = (len(values) - 1) / fps
    interpolate = PchipInterpolator(np.arange(len(values)) / fps, values, axis=0)
    return np.asarray(interpolate(np.minimum(times_s, last_s)))
