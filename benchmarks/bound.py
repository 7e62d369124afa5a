"""Branch and bound on the distance maps of `search`: when is it certain that no other pose fits as well?

    python benchmarks/bound.py certify --within 2 --beyond 1 0.5          # rotations within 2 deg, the shift is known
    python benchmarks/bound.py certify --within 2 0.15 --sample 3000      # all six: how many boxes it would take
    python benchmarks/bound.py misses                                     # does `search` find the least of its cost?

`certify` takes the cost by which `search` ranks its basins. A box of poses (a rotation vector and a shift, left updates
about the camera's centre) is bounded from below by the mean, over the LiDAR edges, of the least value that the map of
distances has where the box may move the edge. Boxes whose bound is below the best known cost are halved, those that
are within `--beyond` deg of the best known pose are left alone. If none is left, no rotation farther away than that,
within the domain, fits as well. With `--sample` N random boxes of a level are kept, and the total number is
estimated. `misses` holds the proposals of `search` against the best of many small searches from all over the domain.
Starts are wrong by four fifths of the domain. Pinhole cameras only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from p2o.arrays import Bool, Float
from p2o.features.view import View
from p2o.frames.selection import select
from p2o.geometry import se3
from p2o.geometry.perturb import parse_perturbation
from p2o.geometry.pose_error import pose_error
from p2o.host.registry import Registry
from p2o.problems.directed_cost import DirectedCost
from p2o.run.recipe import Recipe

TRUNCATE_PX = 4.0
"""Distances are cut off here: `search` ranks its basins so (`finest_px`)."""
TOLERANCE_PX = 1e-4
"""Costs that differ by less are equal: they are computed in single precision."""
_SLOP_PX = 2e-3
"""Pixels are computed in single precision."""
_REACHES_PX = np.array(
    [0.06, 0.12, 0.25, 0.5, *((k - 1) / 2 for k in (3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64))],
)
"""Motions are rounded up to these: above half a pixel they make windows of k cells, each of which is a map."""
_LARGE_PX = 30.0
"""Boxes that move edges by more on average, along rows and columns together, are halved without a look."""
_SMALL_PX = 0.05
"""Boxes that move edges by less are not halved any more: costs change in steps, from cell to cell."""
_AT_ONCE, _LOOKUPS_AT_ONCE = 500, 32_000


@dataclass(frozen=True, eq=False)
class Bound:
    """Lower bounds of a `DirectedCost` (scale 1, not smooth) over boxes of poses.

    A pose is [exp(w) | t] @ around, each |w| at most `turn_rad`, each |t| at most `shift_m`. Boxes are in the chart
    (w_x - rho t_y, w_y + rho t_x, w_z, t), as a shift moves an edge at the depth 1 / rho as a turn does: what is left
    of a shift is the difference of the depths. Centres are (B, 6), half sizes (6,), of all boxes of a level the same.
    """

    cost: DirectedCost
    turn_rad: float
    shift_m: float
    _maps: dict[tuple[int, int, float, float], np.ndarray] = field(default_factory=dict)

    @cached_property
    def rho(self) -> float:
        """The median inverse depth of the edges, 1/m."""
        return float(np.median(np.concatenate([1 / part.xyz[:, 2] for part in self.cost.parts])))

    @cached_property
    def half(self) -> Float:
        """Half sizes (6,) of the box that holds the whole domain."""
        turn = np.array([1.0, 1.0, 0.0]) * self.rho * self.shift_m + self.turn_rad
        return np.concatenate([turn, np.full(3, self.shift_m)])

    @property
    def _farthest_rad(self) -> float:
        """The largest |w| of boxes, which stick out of the domain."""
        return self.turn_rad + 2 * self.rho * self.shift_m

    @cached_property
    def _bend(self) -> float:
        """By how much of its length at most the angular velocity of a rotation vector differs from its derivative.

        The left Jacobian of SO(3) is the mean of exp(s w) over s from 0 to 1, so it differs from 1 by |w| / 2.
        """
        return float(np.sqrt(3) * self._farthest_rad / 2)

    @cached_property
    def _gains(self) -> tuple[tuple[Float, Float, Bool], ...]:
        """For each view px per rad and m: along rows and columns (2, N, 6) of the chart, the same of turn and shift.

        With a = x / z and b = y / z the image of a point moves by

            da = (1 + a^2) w_y - a b w_x - b w_z + (t_x - a t_z) / z
            db = -(1 + b^2) w_x + a b w_y + a w_z + (t_y - b t_z) / z

        a second. Speeds are bounded over all a, b and z that the boxes allow: |a - a_0| is at most D where speeds over
        that range, for a unit of time, are at most D. The last array says where such a D was found.
        """
        out = []
        for part in self.cost.parts:
            x, y, z = part.xyz.T
            a_0, b_0 = np.abs(x / z), np.abs(y / z)
            turn = self._farthest_rad * (1 + np.sqrt(3) * self._bend)
            # A turn about the camera's centre moves what the shift has moved, too.
            shift = self.shift_m + 2 * turn * self.shift_m
            q = np.concatenate([np.full(3, turn), np.full(3, shift)])
            range_a, range_b = (1.5 * gain @ q for gain in _speeds(a_0, b_0, 1 / z))
            a, b = a_0 + range_a, b_0 + range_b
            factor = np.exp(turn * (a + b))
            nearest, farthest = z / factor - shift * factor, z * factor + shift * factor
            known = nearest > 0.05
            nearest = np.where(known, nearest, 1.0)
            plain = _speeds(a, b, 1 / nearest)
            known &= (plain[0] @ q <= range_a) & (plain[1] @ q <= range_b)
            a_least, b_least = np.maximum(a_0 - range_a, 0), np.maximum(b_0 - range_b, 0)
            chart = plain.copy()
            for axis, (least, most) in enumerate(((a_least, a), (b_least, b))):
                ends = 1 / nearest - (1 + least**2) * self.rho, 1 / farthest - (1 + most**2) * self.rho
                chart[axis, :, 3 + axis] = np.maximum(np.abs(ends[0]), np.abs(ends[1]))
                chart[axis, :, 4 - axis] = a * b * self.rho
            focal = np.array(part.camera.params[:2])[:, None, None]
            out.append((focal * chart, focal * plain, known))
        return tuple(out)

    def motion_px(self, half: Float) -> list[Float]:
        """Return for each view how far (2, N) a box moves its edges at most from where its centre puts them.

        Infinite where nothing is known, as of points that the domain may bring close to the camera.
        """
        turn = half[:3] + self.rho * np.array([half[4], half[3], 0.0])
        bend = self._bend * float(np.linalg.norm(turn))
        x, y, z = (turn + bend) * self.shift_m
        rest = np.concatenate([np.full(3, bend), [y + z, x + z, x + y]])
        return [np.where(known, chart @ half + plain @ rest, np.inf) for chart, plain, known in self._gains]

    def axis(self, half: Float) -> int:
        """Return the axis that moves edges most."""
        return int(np.argmax(half * self._mean_gain))

    def mean_px(self, half: Float) -> float:
        """Return how far a box moves edges on average."""
        return float(self._mean_gain @ half)

    @cached_property
    def _mean_gain(self) -> Float:
        total = np.zeros(6)
        for part, (chart, _, _) in zip(self.cost.parts, self._gains, strict=True):
            total += part.weight @ chart.sum(axis=0)
        return total / self.cost.edges

    def updates(self, centres: Float) -> Float:
        """Return the rotation vectors and shifts (B, 6) of centres."""
        out = np.array(centres, np.float64)
        out[:, 0] += self.rho * out[:, 4]
        out[:, 1] -= self.rho * out[:, 3]
        return out

    def poses(self, centres: Float) -> Float:
        """Return camera_from_lidar (B, 4, 4) of centres."""
        return np.asarray(_transforms(self.updates(centres)) @ se3.inverse(self.cost.lidar_from_around))

    def centre_of(self, pose: Float) -> Float:
        """Return the centre (6,) that is a pose camera_from_lidar (4, 4)."""
        update = pose @ self.cost.lidar_from_around
        turn, (x, y, z) = se3.rotation_vector(update[:3, :3]), update[:3, 3]
        return np.array([turn[0] - self.rho * y, turn[1] + self.rho * x, turn[2], x, y, z])

    def values(self, centres: Float) -> Float:
        """Return the cost (B,) in pixels of centres."""
        return self.cost(self.poses(centres))

    def outside(self, centres: Float, half: Float) -> Bool:
        """Return which boxes hold no pose of the domain."""
        least = np.abs(self.updates(centres)[:, :3]) - self._turn(half)
        return np.asarray((least > self.turn_rad + 1e-12).any(axis=1))

    def farthest_rad(self, centres: Float, half: Float, pose: Float) -> Float:
        """Return a bound (B,) on how far the rotations of boxes are from that of a pose."""
        away = np.abs(self.updates(centres) - self.updates(self.centre_of(pose)[None]))[:, :3]
        return np.asarray(np.linalg.norm(away + self._turn(half), axis=1))

    def _turn(self, half: Float) -> Float:
        return np.asarray(half[:3] + self.rho * np.array([half[4], half[3], 0.0]))

    def lower(self, centres: Float, half: Float) -> Float:
        """Return lower bounds (B,) in pixels of the cost in boxes of one size."""
        groups, total = self._groups(half), np.zeros(len(centres))
        for first in range(0, len(centres), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            transforms = _transforms(self.updates(centres[some]))[:, :3]
            for number, part in enumerate(self.cost.parts):
                fx, fy, cx, cy = part.camera.params
                intrinsic = np.array([[fx, 0, cx + _BORDER], [0, fy, cy + _BORDER], [0, 0, 1]])
                matrix = np.ascontiguousarray((intrinsic @ transforms).transpose(1, 2, 0), np.float32)
                at_once = max(1, _LOOKUPS_AT_ONCE // matrix.shape[2])
                for side, reach, rows in groups[number]:
                    for begin in range(0, len(rows), at_once):
                        chunk = rows[begin : begin + at_once]
                        least = self._least(number, side, reach, part.homogeneous[chunk], matrix)
                        total[some] += part.weight32[chunk] @ least
        return total / self.cost.edges

    def _groups(self, half: Float) -> list[list[tuple[int, tuple[float, float], np.ndarray]]]:
        """Return for each view the direction, the reach along rows and columns, and the edges that have both."""
        out = []
        for part, motion in zip(self.cost.parts, self.motion_px(half), strict=True):
            # What is not known, or may go anywhere, is bounded by 0: left out.
            known = (motion + _SLOP_PX <= _REACHES_PX[-1]).all(axis=0)
            keys = np.stack([part.side_index, *np.searchsorted(_REACHES_PX, motion + _SLOP_PX)])
            groups = []
            for side, across, down in np.unique(keys[:, known], axis=1).T:
                rows = np.flatnonzero(known & (np.array([side, across, down]) == keys.T).all(axis=1))
                groups.append((int(side), (float(_REACHES_PX[across]), float(_REACHES_PX[down])), rows))
            out.append(groups)
        return out

    def _least(self, view: int, side: int, reach: tuple[float, float], points: Float, matrix: Float) -> Float:
        """Return the least value (N, B) of a map within reach of where points are."""
        u, v, z = points @ matrix[0], points @ matrix[1], points @ matrix[2]
        u /= z
        v /= z
        if max(reach) > 0.5:
            across, down = (max(r, 0.5) for r in reach)
            least = self._windows(view, side, across, down)
            height, width = least.shape
            # Windows begin at their first cell.
            column, row = (_cells(at - np.float32(r), n) for at, r, n in ((u, across, width), (v, down, height)))
            return np.asarray(least.reshape(-1).take(row * width + column) * self._unit)
        base = self._bases[view][side]
        height, width = base.shape
        columns = [_cells(u + np.float32(sign * reach[0]), width) for sign in (-1, 1)]
        rows = [_cells(v + np.float32(sign * reach[1]), height) * width for sign in (-1, 1)]
        corners = [base.reshape(-1).take(row + column) for row in rows for column in columns]
        return np.asarray(np.minimum.reduce(corners))

    @cached_property
    def _bases(self) -> list[list[np.ndarray]]:
        """Maps of each view with a border that costs what it costs to be outside."""
        out = []
        for part in self.cost.parts:
            maps = []
            for side, distances in enumerate(np.minimum(part.maps, np.float32(self.cost.truncate_px))):
                base, neutral = distances.copy(), np.float32(part.neutral[side])
                # Within half a cell of its end an image ends.
                for end in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
                    base[end] = np.minimum(base[end], neutral)
                maps.append(cv2.copyMakeBorder(base, *[_BORDER] * 4, cv2.BORDER_CONSTANT, value=float(neutral)))
            out.append(maps)
        return out

    @cached_property
    def _unit(self) -> np.float32:
        return np.float32(self.cost.truncate_px / 255 * (1 - 1e-6))

    def _windows(self, view: int, side: int, across: float, down: float) -> np.ndarray:
        """Return the least value of the windows that begin at each cell, in bytes, rounded down."""
        key = view, side, across, down
        if key not in self._maps:
            floor = np.floor(self._bases[view][side] / self._unit).astype(np.uint8)
            shape = (int(2 * down) + 1, int(2 * across) + 1)
            wider = cv2.copyMakeBorder(floor, 0, shape[0], 0, shape[1], cv2.BORDER_REPLICATE)
            least = cv2.erode(wider, np.ones(shape, np.uint8), anchor=(0, 0))
            self._maps[key] = np.ascontiguousarray(least[: floor.shape[0], : floor.shape[1]])
        return self._maps[key]


_BORDER = 66
"""Wider than the widest window: windows that are all outside the image hold nothing of it."""


def _speeds(a: Float, b: Float, inverse_depth: Float) -> Float:
    """Return how fast a and b (2, N, 6) move at most, for each of turn and shift."""
    zero = np.zeros_like(a)
    along = np.stack([a * b, 1 + a * a, b, inverse_depth, zero, a * inverse_depth], axis=1)
    down = np.stack([1 + b * b, a * b, a, zero, inverse_depth, b * inverse_depth], axis=1)
    return np.stack([along, down])


def _transforms(updates: Float) -> Float:
    """Return (B, 4, 4) of rotation vectors and shifts (B, 6)."""
    out = se3.exp(np.concatenate([updates[:, :3], np.zeros((len(updates), 3))], axis=1))
    out[:, :3, 3] = updates[:, 3:]
    return out


def _cells(at: Float, count: int) -> np.ndarray:
    """Return the numbers of the cells, those beyond an end as the last one there."""
    return np.clip(np.rint(at), 0, count - 1).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Proof:
    """What came of it: `certain` where no box is left; else `lowest_px` bounds what may be found in those that are."""

    certain: bool
    boxes: float
    looked_at: int
    seconds: float
    pose: Float
    cost_px: float
    lowest_px: float


def tiles(cost: DirectedCost, turn_rad: float, shift_m: float) -> list[Bound]:
    """Return bounds on domains that together hold all poses within `turn_rad` and `shift_m`, each small in rotation.

    Bounds on how edges move are of a whole domain: those of large ones are loose.
    """
    count = int(np.ceil(turn_rad / _WIDEST_RAD))
    if count == 1:
        return [Bound(cost, turn_rad, shift_m)]
    half, around = turn_rad / count, se3.inverse(cost.lidar_from_around)
    # Relative to its middle c a rotation exp(w) has the vector of exp(w) exp(-c), not w - c: see `Bound._bend`.
    wide, maps, out = half * (1 + 1.5 * turn_rad), {}, []
    for middle in np.stack(np.meshgrid(*[np.arange(1 - count, count, 2) * half] * 3), axis=-1).reshape(-1, 3):
        turned = se3.exp(np.concatenate([middle, np.zeros(3)]))
        parts = tuple(replace(part, xyz=se3.apply(turned, part.xyz)) for part in cost.parts)
        moved = replace(cost, parts=parts, lidar_from_around=se3.inverse(turned @ around))
        out.append(Bound(moved, wide, shift_m, maps))
    return out


_WIDEST_RAD = np.radians(2.0)


def certify_all(bounds: Sequence[Bound], pose: Float, beyond_rad: float, **words: Any) -> Proof:
    """Return the results of `certify` for several domains; stop after the first without a proof."""
    limit_s, whole = words.pop("limit_s", 60.0), None
    for bound in bounds:
        proof = certify(
            bound, pose, beyond_rad, beaten=whole, limit_s=limit_s - (whole.seconds if whole else 0), **words
        )
        if whole is not None:
            proof = replace(
                proof,
                boxes=proof.boxes + whole.boxes,
                looked_at=proof.looked_at + whole.looked_at,
                seconds=proof.seconds + whole.seconds,
            )
        whole = proof
        if not proof.certain:
            break
    assert whole is not None
    return whole


def certify(
    bound: Bound,
    pose: Float,
    beyond_rad: float,
    *,
    beaten: Proof | None = None,
    sample: int | None = None,
    limit_s: float = 60.0,
    seed: int = 0,
) -> Proof:
    """Halve boxes level by level until none is left that may hold less than the cost of a pose (4, 4), or time is up.

    Boxes within `beyond_rad` of the rotation of that pose are left alone. If a better pose is evaluated, its cost
    is the
    one to beat, or what `beaten` has found elsewhere. With `sample` at most N boxes of a level are halved, at
    random, and `boxes` estimates what all would come to; nothing is proved then.
    """
    began, rng = time.process_time(), np.random.default_rng(seed)
    centres, half, share = np.zeros((1, 6)), bound.half.copy(), 1.0
    best, cost = (pose, bound.cost.at(pose)) if beaten is None else (beaten.pose, beaten.cost_px)
    boxes, looked_at = 0.0, 0
    while True:
        if bound.mean_px(half) <= _LARGE_PX:
            centres = centres[~bound.outside(centres, half)]
            centres = centres[bound.farthest_rad(centres, half, pose) > beyond_rad]
            lower = bound.lower(centres, half)
            boxes, looked_at = boxes + len(centres) / share, looked_at + len(centres)
            tried = centres[np.argsort(lower)[:_AT_ONCE]]
            if len(tried) and (values := bound.values(tried)).min() < cost - TOLERANCE_PX:
                cost, best = float(values.min()), bound.poses(tried[[values.argmin()]])[0]
            open_ = lower < cost - TOLERANCE_PX
            lowest = float(lower[open_].min(initial=cost))
            seconds = time.process_time() - began
            if not open_.any() or seconds > limit_s or bound.mean_px(half) < _SMALL_PX:
                return Proof(not open_.any(), boxes, looked_at, seconds, best, cost, lowest)
            centres = centres[open_]
            if sample is not None and len(centres) > sample:
                share *= sample / len(centres)
                centres = centres[rng.choice(len(centres), sample, replace=False)]
        axis = bound.axis(half)
        half[axis] /= 2
        step = np.zeros(6)
        step[axis] = half[axis]
        centres = np.concatenate([centres - step, centres + step])


def descended(cost: DirectedCost, start: Float, sigma: Float, rng: np.random.Generator, *, small: bool) -> Float:
    """Return the best pose (4, 4) that a population met that narrows from `sigma` (6,), rad and m, about a start."""
    generations, population, keep = (4, 60, 10) if small else (12, 200, 20)
    mean, spread, best, least = np.zeros(6), np.diag(sigma**2), np.zeros(6), np.inf
    for _ in range(generations):
        draws = rng.multivariate_normal(mean, spread + 1e-18 * np.eye(6), population, method="eigh")
        draws[:2] = mean, best
        draws[:, sigma == 0] = 0.0
        values = cost(_transforms(draws) @ start)
        order = np.argsort(values, kind="stable")[:keep]
        if values[order[0]] < least:
            least, best = float(values[order[0]]), draws[order[0]]
        mean, spread = draws[order].mean(axis=0), np.cov(draws[order].T)
    return np.asarray(_transforms(best[None])[0] @ start)


def from_all_over(
    cost: DirectedCost, start: Float, domain: Float, rng: np.random.Generator, count: int, finest: Float
) -> Float:
    """Return the best pose (4, 4) of `count` small searches that begin anywhere in a domain (6,), rad and m."""
    starts = _transforms(rng.uniform(-1, 1, (count, 6)) * domain) @ start
    ends = [descended(cost.truncated(2 * TRUNCATE_PX), at, domain * 0.15, rng, small=True) for at in starts]
    fine = cost.truncated(TRUNCATE_PX)
    ends = [descended(fine, at, domain * 0.05, rng, small=True) for at in ends]
    best = np.stack(ends)[np.argsort(fine(np.stack(ends)), kind="stable")[:8]]
    return _least(fine, [descended(fine, at, finest, rng, small=False) for at in best])


def _least(cost: DirectedCost, poses: Sequence[Float]) -> Float:
    return poses[int(np.argmin(cost(np.stack(poses))))]


@dataclass(frozen=True, eq=False)
class Case:
    """One or several frames from one wrong start; `cost` is cut off at twice `TRUNCATE_PX`."""

    name: str
    views: tuple[View, ...]
    start: Float
    truth: Float
    cost: DirectedCost


def cases(words: argparse.Namespace) -> Iterator[Case]:
    """Give what the command line asks for."""
    registry = Registry.load()
    plan = Recipe.of(data=words.data, options={"extractor": {"weights": words.weights}}).resolve(registry)
    dataset, pipeline = plan.dataset(), plan.calibrator()
    numbers = select(dataset.names, words.frames, skipped=dataset.skipped)[: words.most]
    turn, shift = _sizes(words.within)
    size = f"camera {0.8 * turn:g}deg {0.8 * shift:g}m"
    for first in range(0, len(numbers) - words.joint + 1, words.joint):
        frames = [dataset[number] for number in numbers[first : first + words.joint]]
        truth = frames[0].camera_from_lidar
        if truth is None:
            raise SystemExit(f"{frames[0].name} has no truth")
        start = parse_perturbation(size).start(truth, np.random.default_rng([words.seed, first]))
        prepared = [pipeline.prepare(frame) for frame in frames]
        views = tuple(view.as_seen_from(start).without_hidden(start) for view in prepared)
        cost = DirectedCost.of(views, start, 2 * TRUNCATE_PX, max_points=4000, smooth=False)
        if not all(view.camera.is_pinhole for view in views):
            raise SystemExit(f"{frames[0].name}: bounds are those of a pinhole camera, and this is none")
        if cost.points:
            yield Case("+".join(frame.name for frame in frames), views, start, truth, cost)


def _sizes(within: Sequence[float]) -> tuple[float, float]:
    return within[0], within[1] if len(within) > 1 else 0.0


def proposals(words: argparse.Namespace) -> Callable[[Case], list[Float]]:
    """Return what proposes poses (4, 4) of a case: the method `search` of the default calibration."""
    initialize = Recipe.of(data=words.data).resolve(Registry.load()).calibrator().initializer

    def propose(case: Case) -> list[Float]:
        return [pose for pose in initialize(case.views, case.start) if not np.allclose(pose, case.start)] or [
            case.start
        ]

    return propose


_FINEST = np.array([np.radians(0.15)] * 3 + [0.02] * 3)
"""From so near ends are narrowed once more before they are compared, rad and m."""


def run_certify(words: argparse.Namespace) -> None:
    turn, shift = _sizes(words.within)
    propose = proposals(words)
    print(
        "| frames | points | cost, px | error, deg | beyond, deg | certain | boxes | s | best cost | its error, deg |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for case in cases(words):
        fine, rng = case.cost.truncated(TRUNCATE_PX), np.random.default_rng(words.seed)
        domain = np.array([np.radians(turn)] * 3 + [shift] * 3)
        pose = from_all_over(case.cost, case.start, domain, rng, 150 if shift else 30, np.minimum(_FINEST, domain))
        if shift:
            ends = [descended(fine, at, _FINEST, rng, small=False) for at in propose(case)]
            pose = _least(fine, [pose, *ends])
        for beyond in words.beyond:
            # Windows are computed again, so that the seconds are those of one proof.
            bounds = tiles(fine, float(np.radians(turn)), shift)
            proof = certify_all(bounds, pose, float(np.radians(beyond)), sample=words.sample, limit_s=words.seconds)
            errors = [pose_error(at, case.truth).rotation_deg for at in (pose, proof.pose)]
            said = "yes" if proof.certain else f"no, at least {proof.lowest_px:.3f} px"
            said = said if words.sample is None else "(sampled)"
            print(
                f"| {case.name} | {fine.points} | {fine.at(pose):.3f} | {errors[0]:.2f} | {beyond:g} | {said} | "
                f"{proof.boxes:.2g} | {proof.seconds:.1f} | {proof.cost_px:.3f} | {errors[1]:.2f} |",
                flush=True,
            )


def run_misses(words: argparse.Namespace) -> None:
    turn, shift = _sizes(words.within)
    propose = proposals(words)
    print("| frames | points | cost at the truth | search | all over | from the truth | errors of the three, deg |")
    print("|---|---|---|---|---|---|---|")
    for case in cases(words):
        fine, rng = case.cost.truncated(TRUNCATE_PX), np.random.default_rng(words.seed)
        domain = np.array([np.radians(turn)] * 3 + [shift] * 3)
        found = [
            _least(fine, [descended(fine, at, _FINEST, rng, small=False) for at in propose(case)]),
            from_all_over(case.cost, case.start, domain, rng, words.starts, _FINEST),
            descended(fine, case.truth, _FINEST, rng, small=False),
        ]
        costs = " | ".join(f"{value:.3f}" for value in fine(np.stack([case.truth, *found])))
        errors = ", ".join(f"{pose_error(at, case.truth).rotation_deg:.2f}" for at in found)
        print(f"| {case.name} | {fine.points} | {costs} | {errors} |", flush=True)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    ways = {"certify": (run_certify, [2.0]), "misses": (run_misses, [2.0, 0.15])}
    for name, (run, within) in ways.items():
        command = commands.add_parser(name)
        command.set_defaults(run=run)
        command.add_argument("--data", default="kitti-odometry:build/data/kitti_odometry")
        command.add_argument("--frames", default="all")
        command.add_argument("--most", type=int, default=6, help="so many frames at most")
        command.add_argument("--joint", type=int, default=1, help="number of frames that are calibrated jointly")
        command.add_argument("--weights", default="kitti", help="of p2ornet")
        command.add_argument("--seed", type=int, default=0, help="of starts")
        command.add_argument("--within", type=float, nargs="+", default=within, help="deg, then m (0: shift is known)")
        if name == "certify":
            command.add_argument("--beyond", type=float, nargs="+", default=[1.0], help="deg from the best known pose")
            command.add_argument("--sample", type=int, help="boxes of a level that are halved")
            command.add_argument("--seconds", type=float, default=60.0, help="processor seconds of a proof at most")
        else:
            command.add_argument("--starts", type=int, default=150, help="small searches")
    words = parser.parse_args(argv)
    words.run(words)


if __name__ == "__main__":
    main()
