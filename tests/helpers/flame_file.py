"""A file with the layout of FLAME and random content: pickled chumpy values and a sparse matrix, no FLAME data.

chumpy is not needed: a module made here provides its class name, as in the real file. The skin is the front of an egg
with two openings in front of two proper eyeballs, so that geometric code (rings of the iris, lids) works.
"""

import pickle
import sys
import types
from pathlib import Path

import numpy as np
from scipy import sparse

SKIN, BALL, EYES = 3931, 546, np.array([[0.03145, 0.215, 0.0375], [-0.03145, 0.215, 0.0375]])


def eyeball(centre: np.ndarray) -> np.ndarray:
    """Vertices of an eyeball: 17 rings of 32 vertices around +z, and two poles, the first of which is the apex."""
    polar = np.radians(np.arange(1, 18) * 7.05)[:, None]
    around = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    unit = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around], axis=-1
    )
    points = np.concatenate([0.0126 * unit.reshape(-1, 3), [[0, 0, 0.0133], [0, 0, -0.0126]]])
    return points + centre


def eyeball_faces() -> np.ndarray:
    """Triangles of an eyeball: 1,088, as in FLAME."""
    ring = np.arange(32)
    after = np.roll(ring, -1)
    rows = [[ring + 32 * k, after + 32 * k, ring + 32 * k + 32] for k in range(16)]
    rows += [[after + 32 * k, after + 32 * k + 32, ring + 32 * k + 32] for k in range(16)]
    rows += [[np.full(32, 544), after, ring], [np.full(32, 545), ring + 512, after + 512]]
    return np.concatenate([np.stack(row[::-1], axis=-1) for row in rows])  # oriented outwards


def skin() -> tuple[np.ndarray, np.ndarray]:
    """Front of an egg with almond-shaped openings at the eyes; the list of triangles is padded to 7,800."""
    x, y = np.meshgrid(np.linspace(-0.07, 0.07, 63), np.linspace(0.11, 0.29, 62), indexing="ij")
    z = -0.03 + 0.095 * np.sqrt(np.maximum(1 - (x / 0.075) ** 2 - ((y - 0.2) / 0.11) ** 2, 0.0))
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    corner = (np.arange(62)[:, None] * 62 + np.arange(61)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 62, corner + 1], -1), np.stack([corner + 1, corner + 62, corner + 63], -1)]
    )
    middle = points[faces].mean(axis=1)
    inside = [(np.abs(middle[:, 0] - eye[0]) / 0.014) ** 2 + ((middle[:, 1] - eye[1]) / 0.006) ** 2 < 1 for eye in EYES]
    faces = faces[~(inside[0] | inside[1])]
    faces = np.concatenate([faces, faces[: 7800 - len(faces)]])
    return np.concatenate([points, np.zeros((SKIN - len(points), 3))]), faces


def arrays(seed: int = 0) -> dict[str, np.ndarray]:
    """The arrays of the layout, as plain arrays. The pupil vertex has FLAME's index."""
    rng = np.random.default_rng(seed)
    surface, triangles = skin()
    template = np.concatenate([surface, *map(eyeball, EYES)])
    faces = np.concatenate([triangles, eyeball_faces() + SKIN, eyeball_faces() + SKIN + BALL])
    for place, apex in ((4051, 3931 + 544), (4597, 4477 + 544)):
        template[[place, apex]] = template[[apex, place]]
        faces = np.select([faces == place, faces == apex], [apex, place], faces)
    weights = rng.random((5023, 5)) ** 4
    weights[3931:] = 0
    weights[3931:4477, 3] = weights[4477:, 4] = 1
    regressor = np.zeros((5, 5023))
    for joint, rows in enumerate((slice(1922, 1940), slice(1930, 1955), slice(1925, 1945))):
        regressor[joint, rows] = rng.dirichlet(np.ones(rows.stop - rows.start))
    before, behind = np.cos(np.radians([12 * 7.05, 13 * 7.05]))  # the two rings around the equator
    for joint, place in ((3, 3931), (4, 4477)):
        regressor[joint, place + 11 * 32 : place + 12 * 32] = -behind / (before - behind) / 32
        regressor[joint, place + 12 * 32 : place + 13 * 32] = before / (before - behind) / 32
    return {
        "v_template": template,
        "shapedirs": rng.normal(0, 0.002, (5023, 3, 400)).astype(np.float32),
        "posedirs": rng.normal(0, 0.0005, (5023, 3, 36)).astype(np.float32),
        "J_regressor": regressor,
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.uint32),
        "f": faces.astype(np.uint32),
    }


def write(path: Path, content: dict[str, np.ndarray], protocol: int = 2) -> None:
    """Write the file as the authors of FLAME do: template and directions as chumpy values, the regressor sparse."""
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
    """Write a landmark embedding: an object array that contains a dictionary."""
    rng = np.random.default_rng(seed)
    content = {
        "full_lmk_faces_idx": rng.integers(0, 7800, (1, 68)),
        "full_lmk_bary_coords": rng.dirichlet(np.ones(3), (1, 68)),
        "static_lmk_faces_idx": rng.integers(0, 7800, 51),
    }
    np.save(path, np.array(content, dtype=object), allow_pickle=True)
    return content
