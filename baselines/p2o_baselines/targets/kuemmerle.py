"""Calibrate with spheres of known size, `--calibrator kuemmerle`, after Kuemmerle and Kuehner 2020.

A sphere has the same shape from every direction: its contour in the image is a cone of tangent rays, its returns lie on
a sphere. The pose that aligns the centres of spheres and cones initialises one least squares on all data: the distance
of each contour ray from the sphere and the range residual of each return, both weighted by their noise, with the centre
of every sphere as a further unknown. Three spheres that are not on a line are needed, in one frame or in several.

Departures: the paper estimates the intrinsics of cameras and several sensors in the same problem; here they are given,
there are two sensors, and only the pose is estimated (`CAMERA_PX` is the uncertainty of the intrinsics, for the
predicted error). Contours are colour edges around a region of one saturated hue, so a sphere needs a colour that
differs from the background; they are fitted by the exact cone of the camera's rays, not by an ellipse in the image, so
that any lens model is possible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import p2o
from p2o import Float, Result, Sphere, Status, se3
from p2o.solving import Judged

from p2o_baselines import examples, target_method
from p2o_baselines.boards.pairing import from_points
from p2o_baselines.bodies.bundle import adjusted
from p2o_baselines.bodies.sphere_in_picture import SphereInPicture, spheres_in_picture
from p2o_baselines.bodies.sphere_in_sweep import SphereInSweep, off_sphere, range_sigma, spheres_in_sweep
from p2o_baselines.outcome import refused
from p2o_baselines.target_method import Sight, TargetOptions, missing_targets, once_per_sweep, solved, unsolved

_LEVER_M = 3.0  # maximum distance between the sensors, so that a ball has about the same range from both
_MOST_TRIPLES = 20_000
_LEAST_HEIGHT_M = 0.15  # of a triangle of middles: less is three on a line


@dataclass(frozen=True)
class SpherePair:
    """A ball of an image with that of the sweep; `frame` is the number of its frame."""

    frame: int
    image: SphereInPicture
    sweep: SphereInSweep


def paired_spheres(sights: Sequence[Sight], seed: int = 0) -> tuple[tuple[SpherePair, ...], Float | None]:
    """Return the pairs that most frames agree on, and that pose (4, 4); None without three consistent pairs."""
    choices = [
        SpherePair(number, ball, sweep)
        for number, sight in enumerate(sights)
        for ball in sight.in_image
        for sweep in sight.in_sweep
        if ball.target.radius_m == sweep.radius_m
        and abs(np.linalg.norm(ball.centre) - np.linalg.norm(sweep.centre)) < _LEVER_M
    ]
    if len(choices) < 3:
        return (), None
    to, of = np.array([c.image.centre for c in choices]), np.array([c.sweep.centre for c in choices])
    off_m = np.array([_depth_m(c.image) for c in choices])
    best: tuple[int, float, Float] | None = None
    for three in _triples(len(choices), seed):
        index = np.array(three)
        if len({id(choices[k].image) for k in three}) < 3 or len({id(choices[k].sweep) for k in three}) < 3:
            continue
        sides = [np.linalg.norm(np.roll(p[index], 1, axis=0) - p[index], axis=1) for p in (to, of)]
        if (np.abs(sides[0] - sides[1]) > 2 * off_m[index].max()).any() or _height_m(of[index]) < _LEAST_HEIGHT_M:
            continue
        pose = from_points(to[index], of[index])
        for _ in range(2):
            off = np.linalg.norm(se3.apply(pose, of) - to, axis=1) / off_m
            near = _once(choices, off)
            if len(near) >= 3 and _height_m(of[near]) >= _LEAST_HEIGHT_M:
                pose = from_points(to[near], of[near])
        off = np.linalg.norm(se3.apply(pose, of) - to, axis=1) / off_m
        near = _once(choices, off)
        rank = (len(near), -float(np.sum(off[near] ** 2)))
        if len(near) >= 3 and (best is None or rank > best[:2]):
            best = (*rank, pose)
            if len(near) == len({(c.frame, id(c.image)) for c in choices}):
                break
    if best is None:
        return (), None
    off = np.linalg.norm(se3.apply(best[2], of) - to, axis=1) / off_m
    return tuple(choices[k] for k in _once(choices, off)), best[2]


def _depth_m(ball: SphereInPicture) -> float:
    """Return the uncertainty of a sphere's centre: half a pixel of its radius in depth, and 5 cm."""
    return float(np.linalg.norm(ball.centre)) * 0.5 / (ball.half_rad * ball.px_per_rad) + 0.05


def _height_m(points: Float) -> float:
    """Return how far points (N, 3) reach from the line nearest to them, root mean square."""
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points)))


def _once(choices: Sequence[SpherePair], off: Float) -> list[int]:
    """Return which choices are near enough, each ball used once, nearest first."""
    used: set[int] = set()
    out = []
    for at in np.argsort(off, kind="stable"):
        if off[at] >= 1:
            break
        ids = {id(choices[at].image), id(choices[at].sweep)}
        if not ids & used:
            used |= ids
            out.append(int(at))
    return sorted(out)


def _triples(count: int, seed: int) -> list[tuple[int, ...]]:
    rng = np.random.default_rng(seed)
    if count <= 40:
        every: list[tuple[int, ...]] = list(combinations(range(count), 3))
        rng.shuffle(every)
        return every
    return [tuple(rng.choice(count, 3, replace=False).tolist()) for _ in range(_MOST_TRIPLES)]


_LEAST = 3
_OTHER_RADIUS, _SIGMAS = 0.04, 3.0  # a fitted radius that differs by this share and deviations is of another size
_LEAST_HEIGHT = 0.1  # of middles across their line, in metres


@dataclass(frozen=True)
class Ball:
    """One pair in the least squares; its own unknowns are its middle (3,) m in the LiDAR frame."""

    pair: SpherePair

    @property
    def camera_scale(self) -> tuple[float, float]:
        """Distance of the ball from the camera in m, and pixels per radian there."""
        return float(np.linalg.norm(self.pair.image.centre)), self.pair.image.px_per_rad

    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return angles of the contour's rays from the ball, then how much too long ranges are, in deviations."""
        image, sweep = self.pair.image, self.pair.sweep
        angles = off_cone(image.rays, se3.apply(camera_from_lidar, own[None])[0], sweep.radius_m)
        off, _, _ = off_sphere(sweep.xyz, own, sweep.radius_m)
        return np.concatenate([angles / image.sigma_rad, (off - bias_m) / self._sigma])

    @cached_property
    def _sigma(self) -> Float:
        """Deviations (N,) of ranges, as they are at the fit to the sweep alone."""
        sweep = self.pair.sweep
        _, _, facing = off_sphere(sweep.xyz, sweep.centre, sweep.radius_m)
        return range_sigma(sweep.xyz, facing, sweep.sigma_m)


def off_cone(rays: Float, centre: Float, radius_m: float) -> Float:
    """Return by what angle in rad unit rays (N, 3) pass outside of a ball at `centre` (3,) m; negative inside."""
    far = float(np.linalg.norm(centre))
    axis = centre / far
    angle = np.arctan2(np.linalg.norm(np.cross(rays, axis), axis=1), rays @ axis)
    return np.asarray(angle - np.arcsin(min(1.0, radius_m / far)))


@dataclass(frozen=True)
class Kuemmerle:
    """The calibrator."""

    options: TargetOptions

    def prepare(self, frame: p2o.Frame) -> Sight:
        """Detect the spheres in image and sweep; the sweep is searched only if the image shows one."""
        targets = list(dict.fromkeys(target for target in frame.targets if isinstance(target, Sphere)))
        asked = ", ".join(f"a sphere of {target.radius_m:g} m radius" for target in targets) or "none"
        images = spheres_in_picture(frame.image, targets)
        radii = tuple(target.radius_m for target in targets) if images else ()
        return Sight(frame.name, asked, images, once_per_sweep(frame.cloud, spheres_in_sweep, radii, self.options))

    def solve(self, prepared: Sequence[Sight], camera_from_lidar: Float) -> Result:
        """Return the pose that aligns the spheres of both sensors. The initial extrinsic is not used."""
        start = np.asarray(camera_from_lidar, np.float64)
        result = unsolved(prepared, start)
        outline = "{}: a region of one saturated colour with a round outline"
        bodies = "round regions of one colour, but no sweep has {} that is isolated and that three rings cross"
        missing = missing_targets(prepared, "sphere", outline, bodies)
        if missing:
            return refused(result, missing)
        pairs, rough = paired_spheres(prepared)
        if rough is None or len(pairs) < _LEAST:
            return refused(result, *_too_few(prepared))
        used = {pair.frame for pair in pairs}
        unmatched = [s.name for number, s in enumerate(prepared) if s.in_image and number not in used]
        result = replace(
            result,
            matches={"spheres": len(pairs), "points": sum(len(pair.sweep.xyz) for pair in pairs)},
            warnings=target_method.pairing_warnings("sphere", "spheres", prepared, unmatched=unmatched),
        )
        wrong = _other_radius(pairs)
        if wrong:
            return refused(result, wrong, Status.TOO_FEW_MATCHES)
        balls, centres = [Ball(pair) for pair in pairs], [pair.sweep.centre for pair in pairs]
        fit = adjusted(balls, rough, centres)
        before, after = (_off_px(pairs, pose) for pose in (start, fit.camera_from_lidar))
        return solved(
            result,
            fit.camera_from_lidar,
            fit.covariance,
            reason=f"contours of {len(pairs)} spheres are {after:.2f} px from the spheres of sweeps (root mean square)",
            judged=Judged("contours off spheres", "px", before, after),
            remedy="add spheres elsewhere in the image",
        )


def _off_px(pairs: Sequence[SpherePair], pose: Float) -> float:
    off = [
        off_cone(p.image.rays, se3.apply(pose, p.sweep.centre[None])[0], p.sweep.radius_m) * p.image.px_per_rad
        for p in pairs
    ]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def _too_few(sights: Sequence[Sight]) -> tuple[str, Status]:
    both = [sight for sight in sights if sight.in_image and sight.in_sweep]
    count = sum(min(len(sight.in_image), len(sight.in_sweep)) for sight in both)
    if count < _LEAST:
        seen = f"{count} spheres are seen by both sensors in {len(sights)} frames"
        return f"{seen}, {_LEAST} or more that are not on a line are needed", Status.TOO_FEW_MATCHES
    centres = np.array([ball.centre for sight in both for ball in sight.in_sweep])
    if np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(centres)) < 1.5 * _LEAST_HEIGHT:
        line = f"the middles of all {len(centres)} spheres lie on a line"
        return f"{line}: put some of them higher, lower, nearer or beside", Status.NOT_OBSERVABLE
    none = f"no pose brings three spheres of sweeps onto those of images, of {count} that both sensors see"
    return f"{none}: is the size in `targets` right, and are they off one line?", Status.TOO_FEW_MATCHES


def _other_radius(pairs: Sequence[SpherePair]) -> str:
    """Return a message if the points of spheres have another radius than `targets` state; "" otherwise."""
    sweeps = [pair.sweep for pair in pairs]
    ratio = np.array([ball.free_radius_m / ball.radius_m for ball in sweeps])
    weight = np.array([(ball.radius_m / ball.radius_sigma_m) ** 2 for ball in sweeps])
    mean, sigma = float(weight @ ratio / weight.sum()), float(1 / np.sqrt(weight.sum()))
    if abs(mean - 1) < max(_OTHER_RADIUS, _SIGMAS * sigma):
        return ""
    size = ", ".join(f"{r:g}" for r in dict.fromkeys(ball.radius_m for ball in sweeps))
    radius = f"{100 * mean:.0f} % of the radius that `targets` say ({size} m): measure it again"
    return f"the points of {len(sweeps)} spheres have {radius}"


METHOD = p2o.Method(
    name="kuemmerle",
    build=Kuemmerle,
    options=TargetOptions,
    summary="Spheres of known size: contours as cones in the image, spheres in the sweep, joint least squares.",
    needs=frozenset({"targets"}),
    cite="Kuemmerle and Kuehner, Unified intrinsic and extrinsic camera and LiDAR calibration under uncertainties, "
    "ICRA 2020",
    example=examples.targets("sphere", "os1-64", 3, "0.5deg 0.04m", "&boards=3"),
)
