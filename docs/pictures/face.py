"""Draws the two pictures of docs/face.md: what sounds do to the mouth, what emotions do to the face.

Emotions have no labels: a viewer should name them. Prints how far emotions at full intensity move landmarks (mm).

Run     python docs/pictures/face.py [FOLDER]
Writes  face-sounds.png, face-emotions.png
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from talkingeyes.audio.annotation import Phoneme
from talkingeyes.core.motion import Motion
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.head.landmarks import motion_landmarks
from talkingeyes.head.looks import dressed_head
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.physiology.articulation import APEX, ArticulationStyle, MouthMotion, mouth_motion
from talkingeyes.physiology.face import (
    EMOTION_EXPRESSIONS,
    FACE_SHAPES,
    INTENSITY_STRENGTH,
    FacialBehaviour,
    expression_weights,
)
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS

SOUNDS = ("a", "m", "a", "b", "o", "p", "u", "s", "i", "f", "a", "S", "u:", "w", "E", "l")
SOUND_S, SOUND_PX, EMOTION_PX = 0.14, 180, 160
# Landmarks of the subject's left half, on which contempt shows, and their axis: up, or the length of the way.
WAYS = {
    "brow_inner": "up",
    "brow_outer": "up",
    "eye_upper_inner": "up",
    "eye_lower_inner": "up",
    "mouth_corner": "way",
    "nose_wing": "up",
}


def shown(face: FacialBehaviour, spoken: MouthMotion, times_s: np.ndarray) -> Motion:
    """Frames of a face that looks ahead."""
    count = len(times_s)
    return Motion.of(
        25.0,
        np.zeros((count, 3)),
        np.zeros((count, 2, 3)),
        jaw=spoken.jaw,
        lid=np.full((count, 2), face.share * face.emotion_expression.lid),
        expression=expression_weights(face, spoken, times_s, np.ones(count)),
        expression_names=FACE_SHAPES,
    )


def silent(emotion: str, share: float) -> Motion:
    """A frame of an emotion in silence."""
    at_s, habit = np.zeros(1), ArticulationStyle(jaw_rest_rad=share * EMOTION_EXPRESSIONS[emotion].jaw_rest_rad)
    return shown(FacialBehaviour(emotion, share), mouth_motion((), at_s, habit), at_s)


def sheet(motions: Sequence[Motion], labels: Sequence[str], size_px: int, path: Path) -> None:
    """All frames in rows of eight, with their labels."""
    head = dressed_head()
    renderer = HeadRenderer(head, FRAMINGS["face"].centred_on(head.eye_centres).view(size_px, size_px))
    frames = [frame for motion in motions for frame in renderer.draw(motion)]
    image = Image.new("RGB", (size_px * 8, size_px * -(-len(frames) // 8)))
    for place, (frame, label) in enumerate(zip(frames, labels, strict=True)):
        tile = Image.fromarray(frame)
        ImageDraw.Draw(tile).text((6, 4), label, fill=(20, 30, 60))
        image.paste(tile, (size_px * (place % 8), size_px * (place // 8)))
    image.save(path)


def displacements_mm(emotion: str) -> list[float]:
    """How far an emotion at full intensity moves the landmarks of WAYS, and the lips apart."""
    rest, felt = (1000.0 * motion_landmarks(silent(*each))[0] for each in (("neutral", 0.0), (emotion, 1.0)))
    moved = dict(zip(LANDMARK_NAMES, felt - rest, strict=True))
    ways = [
        float(np.linalg.norm(moved[f"left_{name}"]) if axis == "way" else moved[f"left_{name}"][1])
        for name, axis in WAYS.items()
    ]
    return [*ways, float(moved["upper_lip_inner"][1] - moved["lower_lip_inner"][1])]


def main() -> None:
    """Both pictures."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parent
    phonemes = [Phoneme(i * SOUND_S, (i + 1) * SOUND_S, symbol) for i, symbol in enumerate(SOUNDS)]
    apexes_s = (np.arange(len(SOUNDS)) + APEX) * SOUND_S
    sounds = mouth_motion(phonemes, apexes_s, ArticulationStyle())
    sheet([shown(FacialBehaviour(), sounds, apexes_s)], SOUNDS, SOUND_PX, folder / "face-sounds.png")
    emotions = [silent(name, share) for share in INTENSITY_STRENGTH[:0:-1] for name in EMOTION_EXPRESSIONS]
    sheet(emotions, [""] * len(emotions), EMOTION_PX, folder / "face-emotions.png")
    print(
        markdown_table(
            ["", *WAYS, "lips apart"],
            [[name, *(f"{each:.1f}" for each in displacements_mm(name))] for name in EMOTION_EXPRESSIONS],
        )
    )


if __name__ == "__main__":
    configure_environment()
    main()
