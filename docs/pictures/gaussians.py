"""The picture of docs/head.md: the open head as a mesh (above) and as its Gaussian avatar (below).

Run: talkingeyes avatar -o avatar && python docs/pictures/gaussians.py avatar
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from talkingeyes.head.gaussian_avatar import load_avatar
from talkingeyes.rendering.open_avatar import Posture
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.splatting import AvatarRenderer

SHOWN = (
    Posture(),
    Posture((20.0, 8.0), framing="face", camera_deg=(15.0, 0.0)),
    Posture(lid=0.5, framing="face"),
    Posture(lid=1.0, jaw_deg=12.0, framing="face", camera_deg=(-25.0, 5.0)),
)


def main() -> None:
    avatar = load_avatar(Path(sys.argv[1]))
    rows = [
        [next(renderer(each, posture.view(300)).draw(posture.motion)) for posture in SHOWN]
        for renderer, each in ((HeadRenderer, avatar.head), (AvatarRenderer, avatar))
    ]
    picture = Image.fromarray(np.vstack([np.hstack(row) for row in rows]))
    picture.save(Path(__file__).with_name("gaussians.webp"), quality=85)


if __name__ == "__main__":
    main()
