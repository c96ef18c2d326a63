"""Vertex normals: area-weighted means of the normals of adjacent faces."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.sparse import csr_array


def vertex_normals(vertices: Float[ndarray, "T V 3"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, "T V 3"]:
    """Unit normals, outward for faces that are counter-clockwise from outside; zero at a vertex without faces."""
    return normals_from_incidence(vertices, faces, incidence_matrix(faces, vertices.shape[1]))


def incidence_matrix(faces: Int[ndarray, "F 3"], vertices: int) -> csr_array:
    """The matrix (V, F) that sums face values at vertices."""
    columns = np.repeat(np.arange(len(faces)), 3)
    return csr_array((np.ones(faces.size, np.float32), (faces.ravel(), columns)), shape=(vertices, len(faces)))


def normals_from_incidence(
    vertices: Float[ndarray, "T V 3"], faces: Int[ndarray, "F 3"], around: csr_array
) -> Float[ndarray, "T V 3"]:
    """`vertex_normals` with a precomputed incidence matrix."""
    first, second, third = (vertices[:, faces[:, corner]] for corner in range(3))
    of_faces = np.cross(second - first, third - first)
    normals = np.stack([around @ frame for frame in of_faces])
    return np.asarray(normals / np.sqrt(np.maximum(np.einsum("tvd,tvd->tv", normals, normals), 1e-24))[..., None])
