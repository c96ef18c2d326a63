"""Rasterises 3D Gaussians: EWA splatting (Zwicker et al. 2001) as in 3D Gaussian splatting (Kerbl et al. 2023).

A Gaussian is projected by the Jacobian of the camera at its mean, widened by a low-pass filter of 0.3 pixels squared,
and composited front to back in the order of its depth. Its opacity in a pixel is that at the pixel's centre, at most
0.99, and none below 1/255. The pixels of all Gaussians are listed in the order of depth and sorted by pixel, as a
sparse matrix of the weights of Gaussians (columns) in pixels (rows): the picture is its product with their colours, and
its transpose is the gradient that `gaussian_avatar` fits colours with. Slabs in depth bound the memory, and Gaussians
behind opaque ones are skipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from scipy.sparse import coo_array, csr_array

from talkingeyes.core.motion import Motion
from talkingeyes.head.gaussian_avatar import GaussianAvatar
from talkingeyes.head.gaussians import Gaussians
from talkingeyes.rendering.shading import BACKGROUND, to_pixels
from talkingeyes.rendering.view import OrbitCamera

LOW_PASS_PX2 = 0.3
MAX_ALPHA, MIN_ALPHA = 0.99, 1 / 255
MIN_DEPTH_M = 0.01
TAN_MARGIN = 1.3  # of the field of view, beyond which the Jacobian stays that of its edge
OPAQUE = 1 / 255  # transmittance below which nothing behind is seen
SLAB_FRAGMENTS = 2_000_000  # pixels of Gaussians that are listed at once; more only of a single larger one
# Real spherical harmonics of degree 0 to 3 in the order and with the signs of 3D Gaussian splatting.
C0, C1 = 0.28209479177387814, 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


@dataclass(frozen=True)
class Splats:
    """Gaussians on the image plane, in the order of depth. `source` are their indices among the Gaussians."""

    centres_px: Float[ndarray, "N 2"]
    covariances_px2: Float[ndarray, "N 3"]  # xx, xy, yy
    opacities: Float[ndarray, " N"]
    source: Int[ndarray, " N"]


def harmonic_basis(directions: Float[ndarray, "N 3"], coefficients: int) -> Float[ndarray, "N K"]:
    """Spherical harmonics at unit directions: 1, 4, 9 or 16 of them."""
    x, y, z = directions.T
    basis = [np.full_like(x, C0)]
    if coefficients > 1:
        basis += [-C1 * y, C1 * z, -C1 * x]
    if coefficients > 4:
        basis += [C2[0] * x * y, -C2[0] * y * z, C2[1] * (3 * z * z - 1), -C2[0] * x * z, C2[2] * (x * x - y * y)]
    if coefficients > 9:
        basis += [-C3[0] * y * (3 * x * x - y * y), C3[1] * x * y * z, -C3[2] * y * (5 * z * z - 1)]
        basis += [C3[3] * z * (5 * z * z - 3), -C3[2] * x * (5 * z * z - 1)]
        basis += [C3[4] * z * (x * x - y * y), -C3[0] * x * (x * x - 3 * y * y)]
    return np.stack(basis, axis=-1)


def colours_from(gaussians: Gaussians, origin: Float[ndarray, " 3"]) -> Float[ndarray, "N 3"]:
    """Colours (sRGB, from 0) of Gaussians seen from a point."""
    away = gaussians.means - origin.astype(np.float32)
    basis = harmonic_basis(away / np.linalg.norm(away, axis=1, keepdims=True), gaussians.harmonics.shape[1])
    return np.asarray(np.maximum(np.einsum("nk,nkc->nc", basis, gaussians.harmonics) + 0.5, 0))


def project(gaussians: Gaussians, view: OrbitCamera) -> Splats:
    """The Gaussians in front of a camera, projected."""
    camera = view.camera
    turn = view.turn.astype(np.float32)
    places = (gaussians.means - view.origin.astype(np.float32)) @ turn
    depth = -places[:, 2]
    order = np.argsort(depth, kind="stable")
    order = order[depth[order] > MIN_DEPTH_M]
    x, y, depth = places[order, 0], places[order, 1], depth[order]
    edge_x, edge_y = (TAN_MARGIN * side / 2 / camera.focal_px for side in (camera.width, camera.height))
    slope_x, slope_y = np.clip(x / depth, -edge_x, edge_x), np.clip(y / depth, -edge_y, edge_y)
    # Rows of the Jacobian of (column, row) by the camera axes x, y, z; rows of the image run down.
    scale = np.float32(camera.focal_px) / depth
    axes = np.matmul(turn.T, gaussians.rotations[order] * gaussians.scales[order][:, None, :])
    across = scale[:, None] * (axes[:, 0] + slope_x[:, None] * axes[:, 2])
    down = -scale[:, None] * (axes[:, 1] + slope_y[:, None] * axes[:, 2])
    covariances = np.stack([(a * b).sum(axis=1) for a, b in ((across, across), (across, down), (down, down))], axis=1)
    covariances[:, [0, 2]] += LOW_PASS_PX2
    centres = np.stack([camera.centre_px[0] + scale * x, camera.centre_px[1] - scale * y], axis=1)
    return Splats(centres, covariances, gaussians.opacities[order], order)


def weight_slabs(splats: Splats, width: int, height: int) -> Iterator[tuple[csr_array, Int[ndarray, " N"]]]:
    """Weights (pixels, splats of the slab) by slabs in depth, and the Gaussians of their columns."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.sqrt(2 * np.log(np.maximum(splats.opacities / MIN_ALPHA, 1)))
    half = reach[:, None] * np.sqrt(splats.covariances_px2[:, [0, 2]])
    size = np.array([width, height])
    low = np.clip(np.ceil(splats.centres_px - half - 0.5), 0, size).astype(np.int64)
    high = np.clip(np.floor(splats.centres_px + half - 0.5) + 1, 0, size).astype(np.int64)
    left = np.ones(width * height)
    visible = np.flatnonzero(((high > low).all(axis=1)) & (reach > 0))
    ends = np.cumsum(np.prod(high[visible] - low[visible], axis=1))
    start = 0
    while start < len(visible):
        before = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, before + SLAB_FRAGMENTS)), start + 1)
        part = visible[start:stop]
        start = stop
        part = part[_seen(left.reshape(height, width), low[part], high[part])]
        if not len(part):
            continue
        pixels, columns, alphas = _fragments(splats, part, low[part, 1], high[part, 1], width, reach[part], left)
        alpha = coo_array((alphas, (pixels, columns)), shape=(width * height, len(part))).tocsr()
        alpha.data = _composited(alpha, left)
        yield alpha, splats.source[part]


@dataclass(frozen=True)
class AvatarRenderer:
    """Renders a Gaussian avatar from one view."""

    avatar: GaussianAvatar
    view: OrbitCamera

    def draw(self, motion: Motion) -> Iterator[UInt8[ndarray, "H W 3"]]:
        """Yield one image per frame."""
        background = to_pixels(BACKGROUND) / 255
        for posed in self.avatar.posed(motion):
            yield splat(posed, self.view, background)


def splat(gaussians: Gaussians, view: OrbitCamera, background: Float[ndarray, " 3"]) -> UInt8[ndarray, "H W 3"]:
    """The picture of Gaussians before a background (sRGB, 0 to 1)."""
    width, height = view.camera.width, view.camera.height
    colours = colours_from(gaussians, view.origin)
    total, light = np.zeros(width * height), np.zeros((width * height, 3))
    for weights, source in weight_slabs(project(gaussians, view), width, height):
        light += weights @ colours[source]
        total += weights.sum(axis=1)
    light += (1 - total)[:, None] * background
    return np.rint(255 * np.clip(light, 0, 1)).astype(np.uint8).reshape(height, width, 3)


def _seen(left: Float[ndarray, "H W"], low: Int[ndarray, "N 2"], high: Int[ndarray, "N 2"]) -> ndarray:
    """Whether a pixel of each box lets light through."""
    sums = np.zeros((left.shape[0] + 1, left.shape[1] + 1), np.int64)
    np.cumsum(np.cumsum(left > OPAQUE, axis=0), axis=1, out=sums[1:, 1:])
    (x0, y0), (x1, y1) = low.T, high.T
    return np.asarray(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0] > 0)


def _fragments(
    splats: Splats,
    part: Int[ndarray, " N"],
    top: Int[ndarray, " N"],
    bottom: Int[ndarray, " N"],
    width: int,
    reach: Float[ndarray, " N"],
    left: Float[ndarray, " P"],
) -> tuple[Int[ndarray, " M"], Int[ndarray, " M"], Float[ndarray, " M"]]:
    """Pixels, columns and opacities of splats, in their order: the pixels inside the ellipse of `reach`."""
    xx, xy, yy = splats.covariances_px2[part].astype(np.float64).T
    sharpness = yy / np.maximum(xx * yy - xy * xy, LOW_PASS_PX2**2)
    # Along a row the exponent is -1/2 (sharpness (x - middle)^2 + dy^2 / yy).
    row_splat, row = _ranges(top, bottom)
    dy = row + 0.5 - splats.centres_px[part, 1][row_splat]
    height = dy * dy / yy[row_splat]
    half = np.sqrt(np.maximum(reach[row_splat] ** 2 - height, 0) / sharpness[row_splat])
    middle = splats.centres_px[part, 0][row_splat] + (xy / yy)[row_splat] * dy
    first = np.clip(np.ceil(middle - half - 0.5), 0, width).astype(np.int64)
    last = np.clip(np.floor(middle + half - 0.5) + 1, first, width).astype(np.int64)
    span, column = _ranges(first, last)
    pixels = (row * np.int32(width))[span] + column
    if left.min() <= OPAQUE:
        lit = np.flatnonzero(left[pixels] > OPAQUE)
        span, column, pixels = span[lit], column[lit], pixels[lit]
    dx = column - (middle - 0.5).astype(np.float32)[span]
    peak = (np.log(splats.opacities[part])[row_splat] - 0.5 * height).astype(np.float32)
    fall = (0.5 * sharpness).astype(np.float32)[row_splat]
    alphas = np.minimum(np.exp(peak[span] - fall[span] * dx * dx), MAX_ALPHA)
    return pixels, row_splat[span], alphas


def _ranges(first: Int[ndarray, " N"], last: Int[ndarray, " N"]) -> tuple[Int[ndarray, " M"], Int[ndarray, " M"]]:
    """The range of each integer of half-open ranges, and the integers."""
    lengths = last - first
    of = np.repeat(np.arange(len(first), dtype=np.int32), lengths)
    shift = (first - np.cumsum(lengths) + lengths).astype(np.int32)
    return of, np.arange(len(of), dtype=np.int32) + shift[of]


def _composited(alpha: csr_array, left: Float[ndarray, " P"]) -> Float[ndarray, " M"]:
    """Weights of a slab, behind the light that is `left` in each pixel, which is updated."""
    so_far = np.zeros(alpha.nnz + 1)
    np.cumsum(np.log1p(-alpha.data), out=so_far[1:])
    start = so_far[alpha.indptr[:-1]]
    with np.errstate(divide="ignore"):
        shift = np.repeat(np.log(left) - start, np.diff(alpha.indptr))
    left *= np.exp(so_far[alpha.indptr[1:]] - start)
    return np.asarray(alpha.data * np.exp((so_far[:-1] + shift).astype(np.float32)))
