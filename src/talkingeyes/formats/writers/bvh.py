"""Head, jaw and eyes as BVH, for programs that animate joints.

Degrees and centimetres, y up, the face towards +z. The root is the head, at the neck joint. Rotation channels are Y, X,
Z: R = Ry Rx Rz. BVH cannot hold lids and face.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.motion import Motion
from talkingeyes.formats.rotations import euler_yxz
from talkingeyes.head.model import HeadModel

CM = 100.0
ROTATION = "Yrotation Xrotation Zrotation"
END_CM = (0.0, 0.0, 1.3)  # end site of a joint


def write_bvh(motion: Motion, head: HeadModel, path: Path) -> None:
    """Write hierarchy and motion."""
    lines = ["HIERARCHY", "ROOT head", "{", "  OFFSET 0 0 0", f"  CHANNELS 6 Xposition Yposition Zposition {ROTATION}"]
    for name, place in zip(("jaw", "left_eye", "right_eye"), (head.joints[2:] - head.joints[1]) * CM, strict=True):
        lines += [f"  JOINT {name}", "  {", "    OFFSET {:.6f} {:.6f} {:.6f}".format(*place)]
        lines += [f"    CHANNELS 3 {ROTATION}", "    End Site", "    {"]
        lines += ["      OFFSET {:g} {:g} {:g}".format(*END_CM), "    }", "  }"]
    lines += ["}", "MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.9f}"]
    joints = (motion.head, motion.jaw, motion.gaze[:, 0], motion.gaze[:, 1])
    rows = np.concatenate([motion.translation * CM, *(np.degrees(euler_yxz(joint)) for joint in joints)], axis=1)
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows.tolist()]
    with atomic_write(path) as partial:
        partial.write_text("\n".join(lines) + "\n")
