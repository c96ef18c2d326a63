"""USD stages with a SkelAnimation of a head: joints and blend shapes by name. Needs the package usd-core."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor

from talkingeyes.core.errors import InputError
from talkingeyes.formats.joint_names import JOINTS, joints_by_name
from talkingeyes.formats.readers.gltf import count_frames, lost_shapes, motion_from_shapes
from talkingeyes.formats.readers.noted import NotedMotion
from talkingeyes.formats.shape_names import shape_names

Result = TypeVar("Result")


# usd-core believes the sizes that a file claims, and ends the process where it fails. So it reads in another one, which
# may have this much memory and time.
MAX_ADDRESSES = 4 * 2**30  # bytes
MAX_S = 120.0


def read_usd(path: Path, fps: float | None = None) -> NotedMotion:
    """Read the first SkelAnimation of a stage."""
    return _apart(path, _read, fps)


def read_layer_data(path: Path) -> dict[str, Any]:
    """The custom data of a layer."""
    return _apart(path, _layer_data)


def _apart(path: Path, read: Callable[..., Result], *arguments: Any) -> Result:
    """A process for each read: one that is kept would hang a parent that is forked, or itself a child."""
    with ProcessPoolExecutor(1, initializer=_bound_memory) as pool:
        try:
            return cast(Result, pool.submit(read, path, *arguments).result(MAX_S))
        except BrokenProcessPool:
            error = f"its reader ended; it may have {MAX_ADDRESSES:,} bytes of memory"
        except TimeoutError:
            pool.shutdown(kill_workers=True)
            error = f"its reader may take {MAX_S:g} s"
    raise InputError(f"{path}: not a readable USD stage ({error})")


def _bound_memory() -> None:
    with contextlib.suppress(ImportError, ValueError):  # Windows and macOS have no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESSES,) * 2)


def _layer_data(path: Path) -> dict[str, Any]:
    from pxr import Sdf

    return {key: str(value) for key, value in Sdf.Layer.FindOrOpen(str(path)).customLayerData.items()}


def _read(path: Path, fps: float | None) -> NotedMotion:
    try:
        from pxr import Tf, Usd, UsdSkel
    except ImportError:
        raise InputError(
            f"{path}: should have the package usd-core installed, got none (pip install usd-core)"
        ) from None
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise InputError(f"{path}: not a readable USD stage ({error})") from None
    found = next((UsdSkel.Animation(prim) for prim in stage.Traverse() if prim.IsA(UsdSkel.Animation)), None)
    if found is None:
        raise InputError(f"{path}: should hold a SkelAnimation, got none")
    rate = float(stage.GetTimeCodesPerSecond()) if fps is None else fps
    step = stage.GetTimeCodesPerSecond() / rate
    frames = count_frames((stage.GetEndTimeCode() - stage.GetStartTimeCode()) / stage.GetTimeCodesPerSecond(), rate)
    codes = stage.GetStartTimeCode() + step * np.arange(frames)
    names = [str(name).rsplit("/", 1)[-1] for name in found.GetJointsAttr().Get() or ()]
    joints = joints_by_name(names)
    turned = {joint: _turns(found, joints.get(joint, []), codes) for joint in JOINTS}
    shapes = shape_names([str(name) for name in found.GetBlendShapesAttr().Get() or ()])
    rows = [found.GetBlendShapeWeightsAttr().Get(code) for code in codes] if shapes else []
    weights = dict(zip(shapes, np.array(rows, np.float64).T, strict=True)) if shapes else {}
    places = np.array([np.array(found.GetTranslationsAttr().Get(code))[0] for code in codes], np.float64)
    gaze = np.stack([turned["left_eye"], turned["right_eye"]], axis=1)
    rest = _rest(stage)
    head = turned["head" if "head" in joints else "neck"]
    return NotedMotion(
        motion_from_shapes(rate, head, gaze, turned["jaw"], places - rest, weights), lost_shapes(weights)
    )


def _turns(animation: Any, joints: list[int], codes: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    if not joints:
        return np.zeros((len(codes), 3))
    values = [animation.GetRotationsAttr().Get(code)[joints[0]] for code in codes]
    wxyz = np.array([[value.GetReal(), *value.GetImaginary()] for value in values], np.float64)
    return np.asarray(Rotation.from_quat(wxyz, scalar_first=True).as_rotvec())


def _rest(stage: Any) -> np.ndarray:
    """Rest position of the root of the skeleton."""
    from pxr import UsdSkel

    skeleton = next((UsdSkel.Skeleton(prim) for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton)), None)
    if skeleton is None:
        return np.zeros(3)
    return np.array(skeleton.GetRestTransformsAttr().Get()[0].ExtractTranslation())
