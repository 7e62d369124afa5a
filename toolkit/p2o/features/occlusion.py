"""Occlusion orders of neighbouring pixels and the occlusion edges that follow from them.

The rule is that of P2ORM (Qiu et al., ECCV 2020, `gen_occ_order` of its code), which the paper used for its labels
(Sec. III-B, IV-A): the nearer pixel occludes its neighbour if the depth discontinuity between them is large, also
between the tangent planes of both surfaces. A road at a grazing angle and a crease are therefore no edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from p2o.arrays import Bool, Float, Int, Int8, checked
from p2o.errors import InputError
from p2o.features.side import SIDES, Side
from p2o.geometry.camera import Camera

_STEP = {"east": (1, 0), "south": (0, 1), "south_east": (1, 1), "north_east": (1, -1)}
"""Step (du, dv) in pixels from the first pixel of a pair to the second."""


@dataclass(frozen=True, eq=False)
class Orders:
    """Occlusion orders of neighbouring pixels, each (H, W) int8 stored at the first pixel p of the pair.

    +1: p hides its neighbour, -1: p is hidden by it, 0: neither, or unknown. The neighbour of (u, v) is (u+1, v) for
    `east`, (u, v+1) for `south`, (u+1, v+1) for `south_east` and (u+1, v-1) for `north_east`; the diagonals are None
    for connectivity 4. Pairs that leave the image are 0. The classes of P2ORM are order + 1. Raises InputError for
    arrays that differ in shape, values other than -1, 0, 1, or a single diagonal.
    """

    east: Int8
    south: Int8
    south_east: Int8 | None = None
    north_east: Int8 | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.east)
        if len(shape) != 2:
            raise InputError("the order east is not a map", expected="(H, W)", got=shape)
        for name, order in self.present.items():
            order = checked(f"the order {name}", order, shape, np.int8)
            if order.size and (order.min() < -1 or order.max() > 1):
                raise InputError(f"the order {name} contains other values", expected="-1, 0, 1", got=np.unique(order))
            object.__setattr__(self, name, order)
        if (self.south_east is None) != (self.north_east is None):
            raise InputError("one diagonal order is missing", expected="south_east and north_east, or neither")

    @property
    def present(self) -> dict[str, Int8]:
        """The orders that are not None, by name: two for connectivity 4, four for 8."""
        return {name: getattr(self, name) for name in _STEP if getattr(self, name) is not None}


def occlusion_orders(
    depth_m: Float,
    camera: Camera,
    *,
    min_jump_m: float = 0.4,
    relative_jump: float = 0.0,
    normals: Float | None = None,
    planes: bool = True,
    masked: Bool | None = None,
    connectivity: Literal[4, 8] = 4,
) -> Orders:
    """Return the occlusion orders of the neighbouring pixels of a depth map.

    `depth_m` (H, W) is depth along the optical axis in metres; +inf is sky (valid, infinitely far), NaN is unknown and
    never makes an edge. Conditions, with the threshold max(min_jump_m, relative_jump * nearer distance):

    1. the distances along the two rays differ by more than the threshold (times sqrt(2) for diagonal pairs);
    2. so do the distances at which the two tangent planes meet the ray half-way between the pixels;
    3. seen through either pixel, the nearer one's plane is in front.

    `normals` (H, W, 3, camera frame, any length or sign) give the tangent planes. Without them they are estimated from
    the pixel and its neighbour on the side away from the pair, because inverse depth is affine on planes (exact for a
    pinhole). An estimated plane may pass exactly through the other pixel's point, so condition 3 then asks for half the
    threshold instead of zero. Where that neighbour is unknown, or outside the image, there is no label, except that sky
    needs none. With `planes` off, condition 1 decides alone. Pairs whose hiding pixel is `masked` (H, W) (foliage)
    become 0, and so do all pairs of a lone spike: a pixel in front of all its neighbours, or behind all of them.

    Raises InputError if an array does not have the size of the camera's image, depth or min_jump_m is not positive,
    or the connectivity is neither 4 nor 8.
    """
    if not min_jump_m > 0:
        raise InputError("the smallest jump is not positive", expected="min_jump_m > 0", got=min_jump_m)
    if connectivity not in (4, 8):
        raise InputError("unknown connectivity", expected="4 or 8", got=connectivity)
    size = (camera.height, camera.width)
    z: Float = checked("depth_m", depth_m, size, np.float64, finite=False)
    if (z <= 0).any():
        raise InputError("depth is not positive", expected="metres > 0, NaN where unknown", got=f"{np.nanmin(z):g}")
    if masked is not None:
        masked = checked("masked", masked, size, np.bool_)
    if normals is not None:
        normals = checked("normals", normals, (*size, 3), np.float64, finite=False)
    distance = z * _ray_length(camera)
    orders = {}
    for name in ("east", "south") if connectivity == 4 else _STEP:
        first, second = _slices(name)
        length = float(np.hypot(*_STEP[name]))
        with np.errstate(invalid="ignore"):  # sky against sky is inf - inf: NaN, hence no discontinuity
            jump = (distance[second] - distance[first]) / length
            if relative_jump > 0:
                nearer = np.minimum(distance[first], distance[second])
                threshold = np.maximum(min_jump_m, relative_jump * nearer)
            else:
                threshold = np.broadcast_to(min_jump_m, jump.shape)
            candidate = np.abs(jump) > threshold
        # Few pairs pass the first condition: tangent planes are computed for those only.
        row, column = np.nonzero(candidate)
        sign, limit = np.sign(jump[row, column]), threshold[row, column]
        if planes:
            p = np.stack([column, row + first[0].start], axis=1)
            through = _plane_distances(z, normals, camera, p, np.array(_STEP[name]))
            margin = 0.5 * limit if normals is None else np.zeros_like(limit)
            with np.errstate(invalid="ignore"):
                clear = sign * (through[:, :, 1] - through[:, :, 0])  # at p, at the middle, at q
                keep = (clear[0] > margin) & (clear[1] / length > limit) & (clear[2] > margin)
            row, column, sign = row[keep], column[keep], sign[keep]
        order = np.zeros(size, np.int8)
        order[first][row, column] = sign
        if masked is not None:
            order[first][np.where(order[first] > 0, masked[first], masked[second])] = 0
        orders[name] = order
    _remove_spikes(orders)
    return Orders(**orders)


def _slices(name: str) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return index expressions of the first and the second pixels of all pairs inside the image."""
    du, dv = _STEP[name]
    whole, ahead, behind = slice(0, None), slice(0, -1), slice(1, None)
    rows = {0: (whole, whole), 1: (ahead, behind), -1: (behind, ahead)}[dv]
    columns = (ahead, behind) if du else (whole, whole)
    return (rows[0], columns[0]), (rows[1], columns[1])


@lru_cache(maxsize=2)
def _ray_length(camera: Camera) -> Float:
    """Return (H, W): metres along the ray of a pixel per metre of depth."""
    if camera.is_pinhole:
        fx, fy, cx, cy = camera.params
        x, y = (np.arange(camera.width) - cx) / fx, (np.arange(camera.height) - cy) / fy
        length = np.sqrt(1.0 + x**2 + (y**2)[:, None])
    else:
        v, u = np.mgrid[: camera.height, : camera.width]
        length = 1.0 / camera.rays(np.stack([u, v], axis=-1))[..., 2]
    length.flags.writeable = False
    return length


def _plane_distances(z: Float, normals: Float | None, camera: Camera, p: Int, step: Int) -> Float:
    """Return metres (3, K, 2) along the rays at pixels p (K, 2), half-way and at p + step to both tangent planes."""
    at = np.stack([p, p + 0.5 * step, p + step])
    rays = camera.rays(at)
    if normals is not None:
        return np.stack([_met(normals, z, camera, end, rays) for end in (p, p + step)], axis=-1)
    plane, length = rays[..., :2] / rays[..., 2:], 1.0 / rays[..., 2]
    inverse = [_extended(z, camera, end, away, plane) for end, away in ((p, p - step), (p + step, p + 2 * step))]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([np.where(i <= 0, np.inf, length / i) for i in inverse], axis=-1)


def _met(normals: Float, z: Float, camera: Camera, end: Int, rays: Float) -> Float:
    """Return where rays (3, K, 3) meet the tangent planes at pixels `end` (K, 2), in metres along the ray."""
    column, row = end.T
    normal = normals[row, column]
    own = camera.rays(end.astype(np.float64))
    depth = z[row, column]
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = np.einsum("ki,ki->k", normal, own) * depth / own[:, 2]
        distance = offset / np.einsum("ki,ski->sk", normal, rays)
    # There is no intersection with a plane behind or parallel to the ray, and none with sky.
    distance[(distance <= 0) | np.isinf(depth)] = np.inf
    return np.asarray(distance)


def _extended(z: Float, camera: Camera, end: Int, away: Int, plane: Float) -> Float:
    """Return the inverse depth (3, K) in 1/m that the line through pixels `away` and `end` (K, 2) has at `plane`.

    `plane` (3, K, 2) are positions on the plane z = 1, where inverse depth is affine on anything flat.
    """
    height, width = z.shape
    inside = ((away >= 0) & (away < (width, height))).all(axis=1)
    clipped = np.clip(away, 0, (width - 1, height - 1))
    inverse = 1.0 / z[end[:, 1], end[:, 0]]
    inverse_away = np.where(inside, 1.0 / z[clipped[:, 1], clipped[:, 0]], np.nan)
    rays = camera.rays(np.stack([end, away]))
    here, behind = rays[..., :2] / rays[..., 2:]
    along = here - behind
    steps = np.einsum("ski,ki->sk", plane - here, along) / np.einsum("ki,ki->k", along, along)
    extended = inverse + steps * (inverse - inverse_away)
    # Sky has inverse depth 0, independent of its neighbours.
    return np.where(inverse == 0, 0.0, extended)


def _remove_spikes(orders: dict[str, Int8]) -> None:
    """Set to 0, in place, all pairs of pixels that occlude all neighbours or are occluded by all neighbours."""
    shape = next(iter(orders.values())).shape
    hidden, hides = np.ones(shape, bool), np.ones(shape, bool)
    for name, order in orders.items():
        first, second = _slices(name)
        own, other = np.zeros(shape, np.int8), np.zeros(shape, np.int8)
        own[first], other[second] = order[first], -order[first]
        hides &= (own > 0) & (other > 0)
        hidden &= (own < 0) & (other < 0)
    spike = hides | hidden
    if spike.any():
        for name, order in orders.items():
            first, second = _slices(name)
            order[first][spike[first] | spike[second]] = 0


def side_maps(orders: Orders) -> Bool:
    """Return (4, H, W): which pixels are foreground with their background to the left, right, upper, bottom.

    A pixel may belong to several maps (a thin pole is both L and R). Diagonal orders are not used, as in the paper.
    """
    maps = np.zeros((len(SIDES), *orders.east.shape), bool)
    maps[Side.LEFT, :, 1:] = orders.east[:, :-1] < 0
    maps[Side.RIGHT, :, :-1] = orders.east[:, :-1] > 0
    maps[Side.UPPER, 1:] = orders.south[:-1] < 0
    maps[Side.BOTTOM, :-1] = orders.south[:-1] > 0
    return maps


def without_short(maps: Bool, min_length_px: int) -> Bool:
    """Return maps (K, H, W) without 8-connected components of fewer than `min_length_px` pixels, for each map."""
    from scipy import ndimage

    flat_neighbours = np.zeros((3, 3, 3), bool)
    flat_neighbours[1] = True
    label, _ = ndimage.label(maps, structure=flat_neighbours)
    keep = np.bincount(label.ravel()) >= min_length_px
    keep[0] = False
    return np.asarray(keep[label])


def edges_from_maps(maps: Bool) -> tuple[Float, Int8]:
    """Return foreground pixels `uv` (N, 2) and sides (N,) int8 of side maps (4, H, W), ordered by side and row."""
    side, v, u = np.nonzero(maps)
    return np.stack([u, v], axis=1).astype(np.float64), side.astype(np.int8)


def edges_from_orders(orders: Orders) -> tuple[Float, Int8]:
    """Return foreground pixels `uv` (N, 2) and their sides (N,) int8; a pixel comes once for each of its sides."""
    return edges_from_maps(side_maps(orders))


def mirrored(orders: Orders) -> Orders:
    """Return the orders of the image flipped left to right.

    A pair is stored at its first pixel, so a flip shifts it by one column and inverts its sign; diagonal pairs also
    change row, because south-east and north-east pairs are exchanged.
    """
    east, south = np.zeros_like(orders.east), orders.south[:, ::-1]
    east[:, :-1] = -orders.east[:, -2::-1]
    if orders.south_east is None or orders.north_east is None:
        return Orders(east, south)
    south_east, north_east = np.zeros_like(orders.east), np.zeros_like(orders.east)
    south_east[:-1, :-1] = -orders.north_east[1:, -2::-1]
    north_east[1:, :-1] = -orders.south_east[:-1, -2::-1]
    return Orders(east, south, south_east, north_east)
