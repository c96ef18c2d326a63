"""The face of a performance: jaw and expression from a model of the face (ProbTalk3D), beside head, gaze and blinks.

The model stands beside that of head and gaze, in the folder `probtalk3d` (of the train stage, or of a packed file), or
is named. It hears the same speech and draws from the same seed, by a stream of its own.

Who moves what: `expression` has no channels of gaze, blinks and jaw, so the model cannot blink. Brows are its own, and
nobody else moves them. What it does around the eyes (squint, wide) gives way as the lids close, so that they meet as
the blink has it. Raised and drooping lids of an emotion are in `lid`, which the model does not give: they come from the
law that the synthetic people follow (physiology.face), and a blink closes what they leave open. Between the model's
frames values are interpolated without overshoot (PCHIP), so lips that meet stay together at any frame rate.

Speech of more than two minutes is given to the model in pieces that overlap by six seconds, each drawn anew (as the
head's latent is), and faded over in the middle of the overlap, where both know what is said before and after: so memory
beside the motion itself does not grow with the speech.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import PchipInterpolator

from talkingeyes.audio.encoder import EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.head.anny import anny_head
from talkingeyes.head.posing import expression_shape_names
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import FaceStyle, StyleKey
from talkingeyes.physiology.face import EMOTION_EXPRESSIONS, INTENSITY_STRENGTH
from talkingeyes.training.face_generators import STYLE_FADE_S, TrainedFaceGenerator, is_face_model, load_face_generator

FACE_MODEL_FOLDER = "probtalk3d"
AROUND_EYES = ("eyeSquint", "eyeWide")
CHUNK_S, OVERLAP_S, CROSSFADE_S = 120.0, 6.0, 0.5
SEED_STREAM = 4  # of the seeds of a sample: 0 to 3 are those of head, gaze and what directs them


@dataclass(frozen=True)
class FaceAnimator:
    """A trained model of the face with its speech encoder."""

    generator: TrainedFaceGenerator
    encoder: SpeechEncoder

    @classmethod
    def load(cls, folder: Path, settings: EmbedSettings, encoder: SpeechEncoder) -> FaceAnimator:
        """From a folder of the train stage; an encoder of these settings is there already.

        Raises InputError if it is no model of the open head's face.
        """
        if not is_face_model(folder):
            raise InputError(f"{folder}: should be a model of the face, such as probtalk3d, got one of other parts")
        head = anny_head()
        generator = load_face_generator(folder, FaceBasis(head.name, expression_shape_names(head)))
        try:
            own = EmbedSettings.model_validate(json.loads((folder / "embedding.json").read_text())["settings"])
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{folder}: not a trained model ({error}); `make repro` trains one") from None
        return cls(generator, encoder if own == settings else make_encoder(own))

    def check(self, style: Sequence[StyleKey]) -> None:
        """Raises InputError (one line, with the choices) for a speaker whom the model does not know."""
        for key in style:
            self.generator.vocabulary.style_vector(key.style)

    def perform(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seed: int, samples: int, fps: float
    ) -> FaceSamples:
        """Faces at the model's rate; sample i of a seed is the same however many are asked for."""
        piece, overlap = round(CHUNK_S * fps), round(OVERLAP_S * fps)
        faces = self._chunk(embedding[:piece], style, (seed, samples, 0), fps)
        for number, start in enumerate(range(piece - overlap, len(embedding) - overlap, piece - overlap), start=1):
            later = [replace(key, onset_s=key.onset_s - start / fps) for key in style]
            following = self._chunk(embedding[start : start + piece], later, (seed, samples, number), fps)
            faces = crossfade(faces, following, start, overlap)
        return faces

    def _chunk(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seed_parts: tuple[int, int, int], fps: float
    ) -> FaceSamples:
        """`seed_parts`: the seed, how many samples, and which piece."""
        seed, samples, number = seed_parts
        streams = [np.random.SeedSequence([seed, index, SEED_STREAM, number]) for index in range(samples)]
        return self.generator.generate(embedding, style, [int(each.generate_state(1)[0]) for each in streams], fps)


def find_face_model(model: Path) -> Path | None:
    """The folder of the model of the face that stands beside a model of head and gaze, if there is one."""
    folder = (
        model.absolute().parent / FACE_MODEL_FOLDER
    )  # not resolved: runs of experiments show results of a store as links
    return folder if folder.is_dir() and folder != model.absolute() else None


def crossfade(faces: FaceSamples, following: FaceSamples, start: int, overlap: int) -> FaceSamples:
    """Faces, then those that follow from frame `start` on; in the middle of the overlap one becomes the other."""
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
    """A motion whose `lid` holds blinks alone, with a face: jaw, expression, and how far its emotion opens the lids."""
    times_s = np.arange(len(motion)) / motion.fps
    expression = np.clip(interpolate_pchip(faces.expression[sample], faces.fps, times_s), 0.0, 1.0)
    closure = np.clip(motion.lid.mean(axis=1), 0.0, 1.0)
    for column, name in enumerate(faces.expression_names):
        if name.startswith(AROUND_EYES):
            expression[:, column] *= 1.0 - closure
    raised = emotion_lid_closure(style, times_s)[:, None]
    return replace(
        motion,
        jaw=interpolate_pchip(faces.jaw[sample], faces.fps, times_s),
        expression=expression,
        expression_names=faces.expression_names,
        head_model=faces.head_model,
        lid=motion.lid + (1.0 - np.clip(motion.lid, 0.0, 1.0)) * raised,
    )


def emotion_lid_closure(style: Sequence[StyleKey], times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    """How far emotions close the lids (below 0: open them) at each time, blended in as the style is."""
    ordered = sorted(style, key=lambda key: key.onset_s)
    found = np.full(len(times_s), _lid(ordered[0].style))
    for key in ordered[1:]:
        found += np.clip((times_s - key.onset_s) / STYLE_FADE_S, 0.0, 1.0) * (_lid(key.style) - found)
    return found


def _lid(style: FaceStyle) -> float:
    return INTENSITY_STRENGTH[style.intensity] * EMOTION_EXPRESSIONS[style.emotion].lid


def interpolate_pchip(
    values: Float[ndarray, "F C"], fps: float, times_s: Float[ndarray, " T"]
) -> Float[ndarray, "T C"]:
    """Values between frames, never beyond those of the two frames around; after the last frame, the last."""
    if len(values) < 2 or not values.shape[1]:
        return np.repeat(values[:1], len(times_s), axis=0)
    last_s = (len(values) - 1) / fps
    course = PchipInterpolator(np.arange(len(values)) / fps, values, axis=0)
    return np.asarray(course(np.minimum(times_s, last_s)))
