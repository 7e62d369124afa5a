"""Detect boards with round holes in an image: ellipses give candidates, rims give the exact pose.

The image of a circle is an ellipse, whose centre is not the image of the circle's centre. Therefore centres of ellipses
are not used: the rims of all holes are fitted together to edges of the image, which is exact for any camera model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
import p2o
from numpy.typing import NDArray
from p2o import Bool, Float, HoleBoard, Int, se3

from p2o_baselines.boards.board_in_picture import BoardInPicture

_LEVELS = (9, 14, 22, 35, 55)  # steps of N grey levels between neighbouring pixels end a uniform area
_BAND_PX = 1.3  # distance of the traced outline outside the steps
_LEAST_RADIUS_PX, _LEAST_RATIO = 5.0, 0.4  # smaller or more oblique ellipses are none
_OFF_ELLIPSE = 0.05  # maximum distance of an outline from its ellipse, as a fraction of the radius
_MOST_ELLIPSES, _MOST_TRIED = 80, 12
_APART = 0.12  # distances between holes are as they should be within this share
_MATCHED = 0.35  # maximum distance of an ellipse from that of a hole, as a fraction of the radius
_FREE_PLACES = 8
_RIM, _SIDE = 48, 40  # number of samples around a hole, and along each side
_STEP_PX = 0.5
_GRID, _PLAIN_STEP, _NEAR_PX, _MOST_MARKED = 16, 12.0, 3, 0.3
"""Between holes a board is uniform: samples each way, largest share on edges, and the edge threshold in grey levels."""
_LEAST_STEP, _LEAST_SHARE = 5.0, 0.3
"""Least gradient of an edge in levels per pixel, and relative to the largest one there."""
_SEEN_OF_HOLE, _SEEN, _LEAST_HOLES = 0.35, 0.5, 3
"""Least share of edges on the rim of a hole, and on all rims, and least number of visible holes."""
_LEAST_OUTLINE = 0.4  # and so much of the outline
_SURE = 0.6  # stop the search if both values exceed this
_MOST_RMS, _MOST_RMS_PX, _LEAST_RIM_PX = 0.03, 0.3, 0.1  # the first of the radius
_POSE_RATIO = 1.12  # poses whose edges scatter so little differently are as good
_WALLED = 0.08  # sine of the angle between ray and board's normal, outwards
_CUT = 2.5  # edges beyond N standard deviations belong to other objects


class Ellipses(NamedTuple):
    """Ellipses on the plane z = 1 of the camera: middles (N, 2), half axes (N, 2) and the turn (N,) of the first."""

    middle: Float
    axes: Float
    turn: Float


class Rims(NamedTuple):
    """Samples on rims: hole (K,), pixels (K, 2), outward normals (K, 2), points (K, 3), and if a wall is visible."""

    hole: Int
    uv: Float
    normal: Float
    xyz: Float
    walled: Bool


def hole_boards_in_picture(image: p2o.Image, targets: Sequence[p2o.Target]) -> tuple[BoardInPicture, ...]:
    """Detect the boards with holes of `targets` in an image of any camera model, each at most once."""
    boards = [target for target in targets if isinstance(target, HoleBoard) and len(target.holes) >= _LEAST_HOLES]
    if not boards:
        return ()
    ellipses = ellipses_of(image)
    levels, steps = np.asarray(image.rgb, np.float32), _steps(image)
    detected: list[BoardInPicture] = []
    for target in boards:
        best: tuple[float, BoardInPicture] | None = None
        for pose in _proposed(ellipses, target, image.camera, steps):
            fit = refined_by_rims(levels, image.camera, target, pose)
            if fit is None or any(_same(fit[1], known) for known in detected):
                continue
            seen, board = _turned_by_outline(levels, image.camera, fit[1])
            if seen > _LEAST_OUTLINE and (best is None or fit[0] * seen > best[0]):
                best = (fit[0] * seen, board)
            if best is not None and best[0] > _SURE:
                break
        chosen = None if best is None else _unambiguous(levels, image.camera, best[1])
        if chosen is not None:
            detected.append(chosen)
    return tuple(detected)


def _unambiguous(levels: NDArray[np.float32], camera: p2o.Camera, board: BoardInPicture) -> BoardInPicture | None:
    """Return the better of the two nearly equivalent poses of a small board; None if both fit equally well."""
    target, own = board.target, board.camera_from_board
    assert isinstance(target, HoleBoard)
    axis = np.cross(own[:3, 2], own[:3, 3] / np.linalg.norm(own[:3, 3]))
    sine = float(np.linalg.norm(axis))
    if sine < 0.03:
        return board
    turn = se3.exp(np.r_[2 * np.arcsin(min(sine, 1.0)) * axis / sine, 0, 0, 0])
    fit = refined_by_rims(levels, camera, target, se3.make(turn[:3, :3] @ own[:3, :3], own[:3, 3]))
    if fit is None or se3.angle_deg(fit[1].camera_from_board @ se3.inverse(own)) < 3.0:
        return board
    if max(fit[1].rms_px, board.rms_px) < _POSE_RATIO * min(fit[1].rms_px, board.rms_px):
        return None
    return fit[1] if fit[1].rms_px < board.rms_px else board


def _same(board: BoardInPicture, other: BoardInPicture) -> bool:
    """Return whether two boards are the same: the centre of one lies on the other."""
    apart = np.linalg.norm(board.camera_from_board[:3, 3] - other.camera_from_board[:3, 3])
    return bool(apart < min(board.target.width_m, board.target.height_m) / 2)


def ellipses_of(image: p2o.Image) -> Ellipses:
    """Return outlines of gaps in uniform areas that are ellipses, in the rays of the camera: candidates of rims."""
    import cv2

    rows: list[tuple[float, float, float, float, float, float]] = []
    # Noise ends no plain area: a dark image is brightened, and smoothed where it is flat.
    bright = image.rgb.astype(np.float32) * (200 / max(float(np.quantile(image.rgb, 0.98)), 20.0))
    smooth = cv2.bilateralFilter(np.clip(bright, 0, 255).astype(np.uint8), 7, 25, 2)
    change = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)).max(axis=2)
    for level in _LEVELS:
        plain = np.asarray(change < level, np.uint8)
        for outline in cv2.findContours(plain, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
            row = _ellipse(outline, image.camera) if _round(outline) else None
            if row is not None:
                rows.append(row)
    table = np.reshape(np.array(sorted(rows)), (-1, 6))[:, 1:]  # the best ellipses first
    kept: list[Float] = []
    for row in table:
        size = np.sqrt(row[2] * row[3])
        if not any(np.hypot(*(row - k)[:2]) < 0.1 * size and abs(row[2] - k[2]) < 0.1 * size for k in kept):
            kept.append(row)
    table = np.reshape(np.array(kept[:_MOST_ELLIPSES]), (-1, 5))
    return Ellipses(table[:, :2], table[:, 2:4], table[:, 4])


def _ellipse(outline: Int, camera: p2o.Camera) -> tuple[float, float, float, float, float, float] | None:
    """Return residual, centre, half axes and rotation of the ellipse of an outline (N, 1, 2) px; None if it is none."""
    import cv2

    rays = camera.rays(outline[:, 0].astype(np.float64))
    if not np.isfinite(rays).all():
        return None
    plane = rays[:, :2] / rays[:, 2:] * camera.focal_px
    (x, y), (first, second), turn = cv2.fitEllipse(plane.astype(np.float32))
    axes = np.array([first, second]) / 2 - _BAND_PX
    if min(axes) < _LEAST_RADIUS_PX * _LEAST_RATIO or min(axes) < _LEAST_RATIO * max(axes):
        return None
    angle = np.radians(turn)
    own = (plane - [x, y]) @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    off = np.abs(np.linalg.norm(own / (axes + _BAND_PX), axis=1) - 1)
    most = max(_OFF_ELLIPSE, 0.4 / min(axes))  # outlines go from pixel to pixel
    if off.mean() > most or off.max() > 4 * most:
        return None
    x, y, first, second = np.array([x, y, *axes]) / camera.focal_px
    return float(off.mean() / most), float(x), float(y), float(first), float(second), float(angle)


def _round(outline: Int) -> bool:
    """Whether an outline (N, 1, 2) px is as large, wide and filled as an ellipse can be."""
    import cv2

    if len(outline) < 1.6 * np.pi * _LEAST_RADIUS_PX:
        return False
    (_, _), (width, height), _ = cv2.minAreaRect(outline)
    small, large = sorted((width, height))
    if small < 2 * _LEAST_RADIUS_PX * _LEAST_RATIO or small < _LEAST_RATIO * large:
        return False
    return bool(0.65 < cv2.contourArea(outline) / (width * height) < 0.88)


def circle_poses(ellipses: Ellipses) -> tuple[Float, Float]:
    """Return middles and normals (N, 2, 3) of both circles of radius 1 that look like each ellipse, by the cone."""
    cosine, sine = np.cos(ellipses.turn), np.sin(ellipses.turn)
    turn = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    inner = turn @ (np.eye(2) / ellipses.axes[:, None, :] ** 2) @ turn.transpose(0, 2, 1)
    middle = ellipses.middle[:, :, None]
    cone = np.zeros((len(inner), 3, 3))
    cone[:, :2, :2] = inner
    cone[:, :2, 2:] = -inner @ middle
    cone[:, 2:, :2] = cone[:, :2, 2:].transpose(0, 2, 1)
    cone[:, 2, 2] = (middle.transpose(0, 2, 1) @ inner @ middle)[:, 0, 0] - 1
    values, vectors = np.linalg.eigh(cone)  # one negative, two positive
    low, small, large = values.T
    across = np.sqrt(np.maximum(large - small, 0.0) / (large - low))
    ahead = np.sqrt((small - low) / (large - low))
    normals = [s * across[:, None] * vectors[:, :, 2] + ahead[:, None] * vectors[:, :, 0] for s in (1.0, -1.0)]
    middles = [_through_section(cone, normal) for normal in normals]
    out, facing = np.stack(middles, axis=1), np.stack(normals, axis=1)
    facing *= -np.sign(np.sum(out * facing, axis=2, keepdims=True))
    return out, facing


def _through_section(cone: Float, normal: Float) -> Float:
    """Return the middles (N, 3) of the circles of radius 1 that planes with normals (N, 3) cut from cones (N, 3, 3)."""
    # The middle of the section is the pole of the plane: cone @ middle is along the normal.
    pole = np.linalg.solve(cone, normal[..., None])[..., 0]
    pole *= np.sign(pole[:, 2:])
    # At a distance k along the pole the section has x' C x = -k^2 pole' C pole about its middle, over the curvature.
    side = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    side /= np.linalg.norm(side, axis=1)[:, None]
    curved = np.einsum("ni,nij,nj->n", side, cone, side)
    own = np.einsum("ni,nij,nj->n", pole, cone, pole)
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sqrt(-own / curved)
        return np.asarray(pole / size[:, None])


def _steps(image: p2o.Image) -> tuple[Bool, Bool]:
    """Return the edges (H, W) of the image, and the pixels near them."""
    import cv2

    kernel = np.ones((3, 3), np.uint8)
    change = cv2.morphologyEx(image.rgb, cv2.MORPH_GRADIENT, kernel).max(axis=2) > 2 * _PLAIN_STEP
    wide = cv2.dilate(change.astype(np.uint8), np.ones((2 * _NEAR_PX - 1, 2 * _NEAR_PX - 1), np.uint8))
    return change, np.asarray(wide, np.bool_)


def _between(target: HoleBoard) -> Float:
    """Return places (N, 3) on a board that are near neither to holes nor to the outline."""
    x, y = (np.linspace(-0.42, 0.42, _GRID) * size for size in (target.width_m, target.height_m))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    clear = np.ones(len(grid), np.bool_)
    for u, v, radius in target.holes:
        clear &= np.hypot(grid[:, 0] - u, grid[:, 1] - v) > 1.25 * radius
    return np.column_stack([grid[clear], np.zeros(clear.sum())])


def _score(camera: p2o.Camera, target: HoleBoard, pose: Float, between: Float, steps: tuple[Bool, Bool]) -> float:
    """Return the share of the rims near edges minus that of the area between holes; -1 if the latter is large."""
    rims = rims_at(camera, target, pose)
    if rims is None or _radius_px(rims) < _LEAST_RADIUS_PX:
        return -1.0
    plain = camera.project(se3.apply(pose, between))
    shares = []
    for uv, where in ((plain, steps[0]), (rims.uv, steps[1])):
        inside = camera.in_image(uv)
        u, v = np.rint(uv[inside]).astype(int).T
        shares.append(float(where[np.clip(v, 0, camera.height - 1), np.clip(u, 0, camera.width - 1)].mean()))
    return shares[1] - shares[0] if shares[0] < _MOST_MARKED else -1.0


def _proposed(ellipses: Ellipses, target: HoleBoard, camera: p2o.Camera, steps: tuple[Bool, Bool]) -> Iterator[Float]:
    """Give poses (4, 4) of the board by pairs of ellipses, those whose rims look most like rims first."""
    count = len(ellipses.middle)
    if count < 2:
        return
    centres, radii = target.centres, np.array([radius for *_, radius in target.holes])
    middles, normals = circle_poses(ellipses)
    rays = middles / np.linalg.norm(middles, axis=2)[..., None]
    scored_poses: list[tuple[float, Float]] = []
    between = _between(target)
    for first, second in permutations(range(len(centres)), 2):
        gap = centres[second] - centres[first]
        for side in range(2):
            at, normal = radii[first] * middles[:, side], normals[:, side]
            # Intersect the ray of each other ellipse, that of its most similar circle, with the plane of this one.
            with np.errstate(divide="ignore", invalid="ignore"):
                similar = np.argmax(np.einsum("ai,bsi->abs", normal, normals), axis=2)
                ray = rays[np.arange(count)[None], similar]
                reach = np.sum(at * normal, axis=1)[:, None] / np.einsum("ai,abi->ab", normal, ray)
                away = reach[..., None] * ray - at[:, None]
                fits = np.abs(np.linalg.norm(away, axis=2) / np.linalg.norm(gap) - 1) < _APART
            for a, b in np.argwhere(fits & ~np.eye(count, dtype=np.bool_)):
                pose = _by_direction(at[a], normal[a], centres[first], gap, away[a, b])
                hits, misfit = _explained(ellipses, pose, centres, radii)
                if hits >= 2:
                    score = _score(camera, target, pose, between, steps)
                    if score > 0:
                        scored_poses.append((score + 0.1 * hits - 0.02 * misfit, pose))
    scored_poses.sort(key=lambda each: -each[0])
    given: list[Float] = []
    for _, pose in scored_poses:
        if len(given) >= _MOST_TRIED:
            return
        if not any(_same_holes(pose, known, centres) for known in given):
            given.append(pose)
            yield pose


def _by_direction(at: Float, normal: Float, centre: Float, gap: Float, away: Float) -> Float:
    """Return the pose (4, 4) with a hole at `at` (3,), the board's normal, and its `gap` (3,) along `away` (3,)."""
    z = -normal
    along = away - (away @ z) * z
    along /= np.linalg.norm(along)
    cosine, sine = gap[:2] / np.linalg.norm(gap[:2])
    # gap = x cosine + y sine is measured along `along`, with y = z x x.
    x = cosine * along - sine * np.cross(z, along)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return se3.make(rotation, at - rotation @ centre)


def _explained(ellipses: Ellipses, pose: Float, centres: Float, radii: Float) -> tuple[int, float]:
    """Return the number of holes with an ellipse at the projected position, and the distances relative to radii."""
    xyz = se3.apply(pose, centres)
    if (xyz[:, 2] < 0.2).any():
        return 0, np.inf
    plane, size = xyz[:, :2] / xyz[:, 2:], radii / xyz[:, 2]
    off = np.linalg.norm(ellipses.middle[None] - plane[:, None], axis=2) / size[:, None]
    wide = np.abs(ellipses.axes.max(axis=1)[None] / size[:, None] - 1)
    nearest = np.min(np.where(wide < 0.35, off, np.inf), axis=1)
    near = nearest < _MATCHED
    return int(near.sum()), float(nearest[near].sum())


def _same_holes(pose: Float, other: Float, centres: Float) -> bool:
    """Whether two poses put holes at the same places, whichever is which."""
    a, b = se3.apply(pose, centres), se3.apply(other, centres)
    nearest = np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1)
    return bool(nearest.max() < 0.02 * np.linalg.norm(a[0]))


def refined_by_rims(
    levels: NDArray[np.float32], camera: p2o.Camera, target: HoleBoard, pose: Float
) -> tuple[float, BoardInPicture] | None:
    """Return the share of the rims on edges of `levels` (H, W, 3) and the board refined near a pose, or None."""
    rims, off, kept, sigma, hessian = None, np.zeros(0), np.zeros(0, np.bool_), 1.0, np.eye(7)
    for turn in range(12):
        rims = rims_at(camera, target, pose)
        if rims is None:
            return None
        radius = _radius_px(rims)
        reach = max(0.35 * radius, 4.0) if turn < 3 else max(0.15 * radius, 3.0)
        off = edge_offsets(levels, rims, reach)
        kept = np.isfinite(off)
        if kept.sum() < 3 * _RIM * _SEEN_OF_HOLE:
            return None
        step, sigma, kept, hessian = _step(camera, rims, off, kept)
        pose = se3.exp(step[:6]) @ pose
        if turn > 5 and np.abs(step[:6]).max() < 1e-6:
            break
    assert rims is not None
    of_hole = np.array([kept[rims.hole == k].mean() for k in range(len(target.holes))])
    share = float(kept.mean())
    too_few = share < _SEEN or (of_hole > _SEEN_OF_HOLE).sum() < _LEAST_HOLES
    if too_few or sigma > max(_MOST_RMS_PX, _MOST_RMS * _radius_px(rims)):
        return None
    # The background seen through a hole shifts sections of its rim together: only N samples of a rim are independent.
    places = min(_FREE_PLACES, 2 * np.pi * _radius_px(rims)) / _RIM
    covariance = np.asarray(max(sigma, _LEAST_RIM_PX) ** 2 * np.linalg.pinv(hessian)[:6, :6] / places)
    uv = rims.uv[kept] + off[kept, None] * rims.normal[kept]
    xyz = se3.apply(pose, target.centres)
    _, by_point = camera.project_with_jacobian(xyz)
    scale = float(np.median(np.linalg.norm(by_point, axis=(1, 2)) * np.linalg.norm(xyz, axis=1)) / np.sqrt(2))
    return share, BoardInPicture(target, uv, pose, covariance, sigma, scale)


def _step(camera: p2o.Camera, rims: Rims, off: Float, kept: Bool) -> tuple[Float, float, Bool, Float]:
    """Return the step (7,) of pose and bloom that moves rims onto edges, deviation, samples, normal matrix (7, 7)."""
    _, by_point = camera.project_with_jacobian(rims.xyz)
    across = np.einsum("ki,kij->kj", rims.normal, by_point)
    rows = np.concatenate([np.cross(rims.xyz, across), across, np.ones((len(across), 1))], axis=1)
    # A wall as bright as the board appears to extend it: such samples follow the other samples.
    sure = kept & ~rims.walled
    sure = sure if sure.sum() > 0.3 * kept.sum() else kept
    weight = sure.astype(np.float64)
    solution, sigma = np.zeros(7), 1.0
    for turn in range(8):
        root = np.sqrt(weight)[:, None]
        target = np.where(kept, off, 0.0)
        solution = np.linalg.lstsq(rows * root, target * root[:, 0], rcond=None)[0]
        rest = np.abs(target - rows @ solution)
        sigma = max(1.4826 * float(np.median(rest[sure])), 0.02)
        weight = np.where((sure if turn < 4 else kept) & (rest < _CUT * sigma), 1.0, 0.0)
    good = weight > 0
    rms = float(np.sqrt((rest[good] ** 2).sum() / max(int(good.sum()) - 7, 1)))
    return solution, rms, good, (rows * weight[:, None]).T @ rows


def _radius_px(rims: Rims) -> float:
    """Return about how large holes are in the image."""
    return float(np.median([np.ptp(rims.uv[rims.hole == k], axis=0).mean() / 2 for k in np.unique(rims.hole)]))


def rims_at(camera: p2o.Camera, target: HoleBoard, pose: Float) -> Rims | None:
    """Return samples on the rims of a board at a pose (4, 4); None if some are not visible."""
    angle = 2 * np.pi * np.arange(_RIM) / _RIM
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(_RIM)], axis=1)
    radii = np.array([radius for *_, radius in target.holes])
    own = target.centres[:, None] + radii[:, None, None] * circle[None]
    along = np.stack([-np.sin(angle), np.cos(angle), np.zeros(_RIM)], axis=1)
    tangent = np.broadcast_to(along, own.shape)
    return _places(camera, pose, own, tangent, np.repeat(np.arange(len(radii)), _RIM), target.centres)


def _places(camera: p2o.Camera, pose: Float, own: Float, tangent: Float, which: Int, middles: Float) -> Rims | None:
    """Return samples `own` (P, M, 3) of the board with directions along the rim, projected at a pose."""
    xyz = se3.apply(pose, own.reshape(-1, 3))
    uv = camera.project(xyz)
    ahead = camera.project(se3.apply(pose, (own + 1e-4 * tangent).reshape(-1, 3)))
    centre = camera.project(se3.apply(pose, middles))[which]
    if not all(np.isfinite(each).all() for each in (uv, ahead, centre)) or not camera.in_image(uv, 30.0).all():
        return None
    direction = ahead - uv
    normal = np.stack([direction[:, 1], -direction[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    normal *= np.sign(np.sum(normal * (uv - centre), axis=1))[:, None]
    outwards = xyz - se3.apply(pose, middles)[which]
    slant = np.sum(outwards * xyz, axis=1) / np.linalg.norm(outwards, axis=1) / np.linalg.norm(xyz, axis=1)
    return Rims(np.asarray(which), uv, normal, xyz, slant > _WALLED)


def edge_offsets(levels: NDArray[np.float32], rims: Rims, reach_px: float) -> Float:
    """Return the outward distance (K,) px of the first clear edge seen from the board; NaN without one nearby."""
    import cv2

    along = np.arange(reach_px, -reach_px - 1e-9, -_STEP_PX)
    maps = (rims.uv[:, None] + along[None, :, None] * rims.normal[:, None]).astype(np.float32)
    seen = cv2.remap(levels, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = np.asarray(seen, np.float64)
    smooth = seen.copy()
    smooth[:, 1:-1] = 0.25 * seen[:, :-2] + 0.5 * seen[:, 1:-1] + 0.25 * seen[:, 2:]
    slope = np.zeros(seen.shape[:2])
    slope[:, 1:-1] = np.linalg.norm(smooth[:, 2:] - smooth[:, :-2], axis=2) / (2 * _STEP_PX)
    top = np.zeros(slope.shape, np.bool_)
    top[:, 1:-1] = (slope[:, 1:-1] >= slope[:, :-2]) & (slope[:, 1:-1] > slope[:, 2:])
    clear = top & (slope > np.maximum(_LEAST_STEP, _LEAST_SHARE * slope.max(axis=1))[:, None])
    first = np.argmax(clear, axis=1)
    rows = np.arange(len(first))
    before, at, after = (slope[rows, np.clip(first + k, 0, len(along) - 1)] for k in (-1, 0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        bow = np.clip(0.5 * (before - after) / (before - 2 * at + after), -0.5, 0.5)
    inside = (rims.uv >= 1).all(axis=1) & (rims.uv < np.array([levels.shape[1], levels.shape[0]]) - 2).all(axis=1)
    return np.where(clear.any(axis=1) & inside, along[first] - np.nan_to_num(bow) * _STEP_PX, np.nan)


def pattern_turns(target: HoleBoard) -> list[Float]:
    """Return the rotations (4, 4) about its normal that map the holes of a board onto themselves."""
    out = []
    holes = np.array(target.holes)
    for quarter in range(4):
        turn = se3.exp(np.array([0, 0, np.pi / 2 * quarter, 0, 0, 0]))
        moved = np.column_stack([se3.apply(turn, target.centres)[:, :2], holes[:, 2]])
        if (np.abs(moved[:, None] - holes[None]).max(axis=2).min(axis=1) < 0.005).all():
            out.append(turn)
    return out


def _turned_by_outline(
    levels: NDArray[np.float32], camera: p2o.Camera, board: BoardInPicture
) -> tuple[float, BoardInPicture]:
    """Return the share of the outline on edges, and the board rotated by the symmetry of its holes with the most."""
    target = board.target
    assert isinstance(target, HoleBoard)
    best, chosen = -1.0, board.camera_from_board
    corners, share = target.outline, np.linspace(0.06, 0.94, _SIDE)[None, :, None]
    side = np.roll(corners, -1, axis=0) - corners
    own = corners[:, None] + share * side[:, None]
    tangent = np.broadcast_to((side / np.linalg.norm(side, axis=1)[:, None])[:, None], own.shape)
    for turn in pattern_turns(target):
        pose = board.camera_from_board @ turn
        sides = _places(camera, pose, own, tangent, np.repeat(np.zeros(4, np.int64), _SIDE), np.zeros((1, 3)))
        if sides is None:
            continue
        off = edge_offsets(levels, sides._replace(normal=-sides.normal), 3.0)
        seen = float(np.mean(np.isfinite(off)))
        if seen > best + 0.02:
            best, chosen = seen, pose
    return best, replace(board, camera_from_board=np.asarray(chosen))
