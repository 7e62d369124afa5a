"""The occlusion rule: which of two neighbouring pixels hides the other, and which edges follow (docs/conventions.md).

The rule is that of P2ORM (Qiu et al., ECCV 2020; `gen_occ_order` of its code), which the paper uses for its labels
(Sec. III-B): the nearer pixel p occludes its neighbour q if the step between them is larger than a threshold, and if
it stays a step when both surfaces are continued by their tangent planes. So neither a road seen at a grazing angle
nor a crease of a facade is an edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from scipy import ndimage

from p2o.arrays import Bool, Float, Int, Int8, checked
from p2o.camera import Camera
from p2o.errors import InputError
from p2o.side import SIDES, Side

_STEPS = {"east": (1, 0), "south": (0, 1), "south_east": (1, 1), "north_east": (1, -1)}


@dataclass(frozen=True, eq=False)
class Orders:
    """Occlusion orders of pixel pairs, each (H, W) int8 stored at the first pixel p of the pair.

    +1: p hides its neighbour, -1: p is hidden by it, 0: neither, or unknown. The neighbour of (u, v) is (u+1, v) for
    `east`, (u, v+1) for `south`, (u+1, v+1) for `south_east` and (u+1, v-1) for `north_east`; the diagonals are None
    for connectivity 4. Pairs that leave the image are 0. Training classes of P2ORM are order + 1.

    Raises InputError for arrays that differ in shape, or values other than -1, 0, 1.
    """

    east: Int8
    south: Int8
    south_east: Int8 | None = None
    north_east: Int8 | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.east)
        if len(shape) != 2:
            raise InputError("orders are not a map", expected="(H, W)", got=shape)
        for name in _STEPS:
            value = getattr(self, name)
            if value is None:
                continue
            order = checked(f"the order {name}", value, shape, np.int8)
            if order.size and (order.min() < -1 or order.max() > 1):
                raise InputError(f"the order {name} is unknown", expected="-1, 0 or 1", got=np.unique(order))
            object.__setattr__(self, name, order)
        if (self.south_east is None) != (self.north_east is None):
            raise InputError("one diagonal order is missing", expected="south_east and north_east, or neither")

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.east.shape[0], self.east.shape[1]


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
    """Return who hides whom among neighbouring pixels of a depth map.

    `depth_m` (H, W) is depth along the optical axis in metres; +inf is sky (valid, infinitely far), NaN is unknown and
    never makes an edge. A step counts when the distances along the rays differ by more than
    max(min_jump_m, relative_jump * nearer distance), times sqrt(2) for diagonal pairs.

    With `planes` the step must persist where tangent planes meet the ray between the two pixels, and each plane must
    lie on its own side at both pixels. The planes come from `normals` (H, W, 3, camera frame, any sign or length), or,
    without them, from the neighbour on the far side of each pixel: inverse depth is affine over the plane z = 1 on
    any surface that is a plane, so two pixels of a line give the third. (A distorted camera bends pixel rows; the
    bend over three pixels is neglected. For a pinhole the planes are exact.) Such an estimated plane may pass exactly
    through the other pixel's point, hence a margin of half the threshold instead of zero. Where no far neighbour is
    known, nothing is decided: no edge. Without `planes` the step alone decides, as P2ORM does without normals.

    Pairs whose hiding pixel is `masked` (H, W) (foliage) become 0, and so do all pairs of a lone spike, a pixel that
    hides all its neighbours or is hidden by all.

    Raises InputError if an array does not have the size of the camera's image, or depth is not positive.
    """
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
    for name in ("east", "south") if connectivity == 4 else _STEPS:
        order = np.zeros(size, np.int8)
        p, q = _pair(order, name), _neighbour(order, name)
        du, dv = _STEPS[name]
        step = float(np.hypot(du, dv))
        with np.errstate(invalid="ignore"):
            jump = (_neighbour(distance, name) - _pair(distance, name)) / step
            nearer = np.minimum(_pair(distance, name), _neighbour(distance, name))
            threshold = np.maximum(min_jump_m, relative_jump * nearer) if relative_jump else np.float64(min_jump_m)
            found = np.abs(jump) > threshold
        del q
        # Few pairs pass the first condition: the planes are worked out for those alone.
        row, column = np.nonzero(found)
        sign = np.sign(jump[row, column])
        if planes and len(row):
            limit = threshold[row, column] if np.ndim(threshold) else np.full(len(row), threshold)
            row_p, column_p = row + max(0, -dv), column
            clearance = _clearance(z, normals, camera, np.stack([column_p, row_p]), np.array([du, dv]))
            margin = np.zeros_like(limit) if normals is not None else 0.5 * limit
            with np.errstate(invalid="ignore"):
                keep = (sign * clearance[0] / step > limit) & (sign * clearance[1:] > margin).all(axis=0)
            row, column, sign = row[keep], column[keep], sign[keep]
        p[row, column] = sign
        if masked is not None:
            p[(p > 0) & _pair(masked, name) | (p < 0) & _neighbour(masked, name)] = 0
        orders[name] = order
    _remove_spikes(orders)
    return Orders(**orders)
