"""Toy faces: a jaw driven by speech, smiles of happy and brows of angry speakers, seven parameters per frame."""

from dataclasses import replace

import numpy as np
from toy import CHANNELS, clip

from talkingeyes.corpus.faces import FaceRecording
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.training.face_task import FaceData

NAMES = ("browDownLeft", "browDownRight", "mouthSmileLeft", "mouthSmileRight")
BASIS = FaceBasis("toy", NAMES)
EMOTIONS = {"neutral": (0.0, 0.0), "happy": (0.0, 0.8), "angry": (0.8, 0.0)}
NORMALISER = Normaliser(tuple(map(str, range(CHANNELS))), np.zeros(CHANNELS, np.float32), np.ones(CHANNELS, np.float32))


def faces(count: int, seed: int, frames: int = 120) -> list[FaceRecording]:
    """`count` clips of speakers a and b in turn, with three emotions."""
    rng = np.random.default_rng(seed)
    return [_face(index, f"face-{seed}-{index}", frames, rng) for index in range(count)]


def _face(index: int, name: str, frames: int, rng: np.random.Generator) -> FaceRecording:
    emotion = list(EMOTIONS)[index % 3]
    brow, smile = EMOTIONS[emotion]
    speech = rng.standard_normal((frames, CHANNELS)).astype(np.float32)
    slow = np.convolve(speech[:, 0], np.ones(5) / 5**0.5, mode="same")
    jaw = np.stack([0.1 * np.clip(slow, 0, None), 0.01 * slow, 0 * slow], axis=1)
    levels = np.array([brow, brow, smile, smile * (0.5 if index % 2 else 1.0)])
    expression = np.clip(levels + 0.03 * rng.standard_normal((frames, 4)), 0, 1)
    who = replace(clip(name, "ab"[index % 2]), emotion=emotion, intensity=0 if emotion == "neutral" else 2)
    return FaceRecording(who, speech, expression.astype(np.float32), jaw.astype(np.float32))


def data(train: int = 12, val: int = 3) -> FaceData:
    """Training data of the toy faces."""
    known = faces(train, seed=1)
    return FaceData(
        known, faces(val, seed=2, frames=48), BASIS, StyleVocabulary.of(each.clip for each in known), NORMALISER
    )
