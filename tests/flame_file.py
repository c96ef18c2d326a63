"""A file of FLAME's layout with random numbers in it: pickled chumpy values and a sparse matrix, no FLAME data.

chumpy is not needed: its class is named by a module made here, as in the real file. The skin is a rough egg around two
proper eyeballs, so that what is geometric (rings of the iris, lid rims) has something to find.
"""

import pickle
import sys
import types
from pathlib import Path

import numpy as np
from scipy import sparse

SKIN, BALL, EYES = 3931, 546, np.array([[0.03145, 0.215, 0.0375], [-0.03145, 0.215, 0.0375]])


def eyeball(centre: np.ndarray) -> np.ndarray:
    """17 rings of 32 vertices around +z, and two poles: the first vertex after the rings is the apex."""
    polar = np.radians(np.arange(1, 18) * 7.05)[:, None]
    around = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    unit = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around], axis=-1
    )
    points = np.concatenate([0.0126 * unit.reshape(-1, 3), [[0, 0, 0.0133], [0, 0, -0.0126]]])
    return points + centre


def arrays(seed: int = 0) -> dict[str, np.ndarray]:
    """The arrays of the layout, plain. The pupil's vertex stands where FLAME has it."""
    random = np.random.default_rng(seed)
    out = random.normal(size=(SKIN, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    template = np.concatenate([out * [0.075, 0.11, 0.095] + [0, 0.2, -0.03], *map(eyeball, EYES)])
    for place, apex in ((4051, 3931 + 544), (4597, 4477 + 544)):
        template[[place, apex]] = template[[apex, place]]
    weights = random.random((5023, 5)) ** 4
    weights[3931:] = 0
    weights[3931:4477, 3] = weights[4477:, 4] = 1
    regressor = np.zeros((5, 5023))
    for joint, rows in enumerate((slice(0, 40), slice(40, 90), slice(90, 140))):
        regressor[joint, rows] = random.dirichlet(np.ones(rows.stop - rows.start))
    before, behind = np.cos(np.radians([12 * 7.05, 13 * 7.05]))  # the two rings around the equator
    for joint, place in ((3, 3931), (4, 4477)):
        regressor[joint, place + 11 * 32 : place + 12 * 32] = -behind / (before - behind) / 32
        regressor[joint, place + 12 * 32 : place + 13 * 32] = before / (before - behind) / 32
    faces = np.concatenate(
        [
            random.integers(0, SKIN, (7800, 3)),
            random.integers(SKIN, 4477, (1088, 3)),
            random.integers(4477, 5023, (1088, 3)),
        ]
    )
    return {
        "v_template": template,
        "shapedirs": random.normal(0, 0.002, (5023, 3, 400)).astype(np.float32),
        "posedirs": random.normal(0, 0.001, (5023, 3, 36)).astype(np.float32),
        "J_regressor": regressor,
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.uint32),
        "f": faces.astype(np.uint32),
    }


def write(path: Path, content: dict[str, np.ndarray], protocol: int = 2) -> None:
    """As FLAME's authors did: template and directions as chumpy values, the regressor sparse."""
    module = types.ModuleType("chumpy.ch")
    Ch = type("Ch", (), {"__module__": "chumpy.ch", "__qualname__": "Ch"})
    module.Ch = Ch  # type: ignore[attr-defined]
    sys.modules |= {"chumpy": types.ModuleType("chumpy"), "chumpy.ch": module}
    try:
        wrapped: dict[str, object] = dict(content)
        for name in ("v_template", "shapedirs"):
            if name in content:
                wrapped[name] = Ch()
                wrapped[name].__dict__.update(x=content[name], _dirty_vars=set(), dtype=content[name].dtype)
        if "J_regressor" in content:
            wrapped["J_regressor"] = sparse.csc_matrix(content["J_regressor"])
        wrapped |= {"bs_style": "lbs", "bs_type": "lrotmin"}
        path.write_bytes(pickle.dumps(wrapped, protocol))
    finally:
        del sys.modules["chumpy"], sys.modules["chumpy.ch"]


def write_embedding(path: Path, seed: int = 0) -> dict[str, np.ndarray]:
    """A landmark embedding: an array of objects that holds a dictionary."""
    random = np.random.default_rng(seed)
    content = {
        "full_lmk_faces_idx": random.integers(0, 7800, (1, 68)),
        "full_lmk_bary_coords": random.dirichlet(np.ones(3), (1, 68)),
        "static_lmk_faces_idx": random.integers(0, 7800, 51),
    }
    np.save(path, np.array(content, dtype=object), allow_pickle=True)
    return content
