"""Draws the two pictures of docs/face.md: what sounds do to the mouth, what emotions do to the face.

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
SOUND_S, SIZE_PX = 0.14, 180
FELT = tuple(name for name in EMOTION_EXPRESSIONS if name != "neutral")


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


def sheet(motions: Sequence[Motion], labels: Sequence[str], columns: int, path: Path) -> None:
    """All frames in rows, labelled."""
    head = dressed_head()
    renderer = HeadRenderer(head, FRAMINGS["face"].centred_on(head.eye_centres).view(SIZE_PX, SIZE_PX))
    frames = [frame for motion in motions for frame in renderer.draw(motion)]
    image = Image.new("RGB", (SIZE_PX * columns, SIZE_PX * -(-len(frames) // columns)))
    for place, (frame, label) in enumerate(zip(frames, labels, strict=True)):
        tile = Image.fromarray(frame)
        ImageDraw.Draw(tile).text((6, 4), label, fill=(20, 30, 60))
        image.paste(tile, (SIZE_PX * (place % columns), SIZE_PX * (place // columns)))
    image.save(path)


def main() -> None:
    """Both pictures."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parent
    phonemes = [Phoneme(i * SOUND_S, (i + 1) * SOUND_S, symbol) for i, symbol in enumerate(SOUNDS)]
    apexes_s = (np.arange(len(SOUNDS)) + APEX) * SOUND_S
    sheet(
        [shown(FacialBehaviour(), mouth_motion(phonemes, apexes_s, ArticulationStyle()), apexes_s)],
        SOUNDS,
        8,
        folder / "face-sounds.png",
    )
    silent_s = np.zeros(1)
    felt = [(name, share) for share in INTENSITY_STRENGTH[1:] for name in FELT]
    habits = [ArticulationStyle(jaw_rest_rad=share * EMOTION_EXPRESSIONS[name].jaw_rest_rad) for name, share in felt]
    motions = [
        shown(FacialBehaviour(name, share), mouth_motion((), silent_s, habit), silent_s)
        for (name, share), habit in zip(felt, habits, strict=True)
    ]
    labels = [f"{name} {INTENSITY_STRENGTH.index(share)}" for name, share in felt]
    sheet(motions, labels, len(FELT), folder / "face-emotions.png")


if __name__ == "__main__":
    configure_environment()
    main()
