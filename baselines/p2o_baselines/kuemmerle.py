"""Balls of known size, `--calibrator kuemmerle`, after Kuemmerle and Kuehner 2020.

    p2o run --data folder:BALLS --joint --calibrator kuemmerle

A ball looks alike from everywhere: its contour in the picture is a cone of rays that touch it, its returns lie on a
sphere. The pose that takes middles of spheres onto those of cones starts one least squares on all: how far each ray of
a contour is from the ball, how much too long each range is for it, both by their noise, with the place of every ball
unknown beside the pose. Three balls that are not on a line are needed, in one frame or in several.

Departures: the paper estimates the intrinsics of cameras and several sensors in the same problem; here they are given,
there are two sensors, and the pose alone is asked for (`camera_px` is how wrong the intrinsics may be, for the likely
error). Contours are steps of colour around a region of one strong hue, so a ball has to have a colour of its own; they
are put on the exact cone by the camera's own rays, not on an ellipse in the picture, so that any lens will do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import p2o
from p2o import Result, Sphere, Status, se3
from p2o.arrays import Float

from p2o_baselines.boards.board_method import likely
from p2o_baselines.bodies.body_options import BodyOptions, refused, too_unsure
from p2o_baselines.bodies.bundle import adjusted
from p2o_baselines.bodies.sphere_in_picture import spheres_in_picture
from p2o_baselines.bodies.sphere_in_sweep import off_sphere, range_sigma, spheres_in_sweep
from p2o_baselines.bodies.sphere_pairing import SpherePair, SphereSight, paired_spheres

_LEAST = 3
_OTHER_RADIUS, _SIGMAS = 0.04, 3.0
"""Balls of another size are told by points whose own radius differs by so much of it, and by so many deviations."""
_LEAST_HEIGHT = 0.1  # of middles across their line, in metres


@dataclass(frozen=True)
class Ball:
    """One pair in the least squares; its own unknowns are its middle (3,) m in the LiDAR frame."""

    pair: SpherePair
    count: int = 3

    @property
    def distance_m(self) -> float:
        """How far the ball is from the camera."""
        return float(np.linalg.norm(self.pair.picture.centre))

    @property
    def px_per_rad(self) -> float:
        """The scale of the picture at the ball."""
        return self.pair.picture.px_per_rad

    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return angles of the contour's rays from the ball, then how much too long ranges are, in deviations."""
        picture, sweep = self.pair.picture, self.pair.sweep
        angles = off_cone(picture.rays, se3.apply(camera_from_lidar, own[None])[0], sweep.radius_m)
        off, _, _ = off_sphere(sweep.xyz, own, sweep.radius_m)
        return np.concatenate([angles / picture.sigma_rad, (off - bias_m) / self._sigma])

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
    """The whole method."""

    options: BodyOptions

    def prepare(self, frame: p2o.Frame) -> SphereSight:
        """Return the balls in picture and sweep; the sweep is searched only where the picture shows one."""
        targets = list(dict.fromkeys(target for target in frame.targets if isinstance(target, Sphere)))
        asked = ", ".join(f"a sphere of {target.radius_m:g} m radius" for target in targets) or "none"
        pictures = spheres_in_picture(frame.image, targets)
        radii = [target.radius_m for target in targets] if pictures else []
        far, sigma = self.options.farthest_m, self.options.scatter_m
        sweeps = spheres_in_sweep(frame.cloud, radii, farthest_m=far, sigma_m=sigma) if radii else ()
        return SphereSight(frame.name, asked, pictures, sweeps)

    def solve(self, prepared: Sequence[SphereSight], camera_from_lidar: Float) -> Result:
        """Return the pose at which the balls of both sensors are the same. The start is not used."""
        options, start = self.options, np.asarray(camera_from_lidar, np.float64)
        blank = Result(tuple(sight.name for sight in prepared), start, start, Status.NO_FEATURES, "")
        nothing = _nothing(prepared)
        if nothing:
            return refused(blank, Status.NO_FEATURES, nothing)
        pairs, rough = paired_spheres(prepared)
        if rough is None or len(pairs) < _LEAST:
            return refused(blank, *_too_few(prepared))
        told = replace(
            blank,
            matches={"spheres": len(pairs), "points": sum(len(pair.sweep.xyz) for pair in pairs)},
            warnings=_remarks(prepared, pairs),
        )
        wrong = _other_radius(pairs)
        if wrong:
            return refused(told, Status.TOO_FEW_MATCHES, wrong)
        balls = [Ball(pair) for pair in pairs]
        fit = adjusted(
            balls,
            rough,
            [pair.sweep.centre for pair in pairs],
            range_bias_m=options.range_bias_m,
            camera_px=options.camera_px,
        )
        unsure = too_unsure(fit.covariance, fit.camera_from_lidar, "spheres", options)
        if fit.covariance is None or unsure:
            return refused(told, Status.NOT_OBSERVABLE, unsure)
        before, after = (_off_px(pairs, pose) for pose in (start, fit.camera_from_lidar))
        return Result(
            told.frames,
            start,
            fit.camera_from_lidar,
            Status.CONVERGED,
            f"contours of {len(pairs)} spheres lie {after:.2f} px off where sweeps put them (root mean square)",
            covariance=fit.covariance,
            accuracy=likely(fit.covariance, fit.camera_from_lidar),
            matches=told.matches,
            judged=p2o.Judged("contours off spheres", "px", before, after),
            warnings=told.warnings,
        )


def _off_px(pairs: Sequence[SpherePair], pose: Float) -> float:
    off = [
        off_cone(p.picture.rays, se3.apply(pose, p.sweep.centre[None])[0], p.sweep.radius_m) * p.picture.px_per_rad
        for p in pairs
    ]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def _nothing(sights: Sequence[SphereSight]) -> str:
    """Return in words that there are no balls to pair; "" where there are."""
    asked = next((sight.asked for sight in sights if sight.asked != "none"), "none")
    if asked == "none":
        return "no frame says that it shows a sphere: state it in `targets` of frame.yaml"
    seen = [sight for sight in sights if sight.pictures]
    if not seen:
        return f"no picture of {len(sights)} shows {asked}: a region of one strong colour with a round outline"
    if not any(sight.sweeps for sight in seen):
        return (
            f"{len(seen)} of {len(sights)} pictures show round regions of one colour, but no sweep has {asked} that "
            "three rings meet and that stands by itself"
        )
    return ""


def _too_few(sights: Sequence[SphereSight]) -> tuple[Status, str]:
    both = [sight for sight in sights if sight.pictures and sight.sweeps]
    count = sum(min(len(sight.pictures), len(sight.sweeps)) for sight in both)
    if count < _LEAST:
        return Status.TOO_FEW_MATCHES, (
            f"{count} spheres are seen by both sensors in {len(sights)} frames, {_LEAST} or more that are not on a "
            "line are needed"
        )
    centres = np.array([ball.centre for sight in both for ball in sight.sweeps])
    if np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(centres)) < 1.5 * _LEAST_HEIGHT:
        return Status.NOT_OBSERVABLE, (
            f"the middles of all {len(centres)} spheres lie on a line: put some of them higher, lower, nearer or beside"
        )
    return Status.TOO_FEW_MATCHES, (
        f"no pose brings three spheres of sweeps onto those of pictures, of {count} that both sensors see: "
        "is the size in `targets` right, and are they off one line?"
    )


def _other_radius(pairs: Sequence[SpherePair]) -> str:
    """Return in words that the points of balls have another radius than `targets` say; "" where they have not."""
    sweeps = [pair.sweep for pair in pairs]
    ratio = np.array([ball.free_radius_m / ball.radius_m for ball in sweeps])
    weight = np.array([(ball.radius_m / ball.radius_sigma_m) ** 2 for ball in sweeps])
    mean, sigma = float(weight @ ratio / weight.sum()), float(1 / np.sqrt(weight.sum()))
    if abs(mean - 1) < max(_OTHER_RADIUS, _SIGMAS * sigma):
        return ""
    size = ", ".join(f"{r:g}" for r in dict.fromkeys(ball.radius_m for ball in sweeps))
    return (
        f"the points of {len(sweeps)} spheres have {100 * mean:.0f} % of the radius that `targets` say ({size} m): "
        "measure it again"
    )


def _remarks(sights: Sequence[SphereSight], pairs: Sequence[SpherePair]) -> tuple[str, ...]:
    """Return what is worth a line: frames whose ball one sensor alone sees."""
    used = {pair.frame for pair in pairs}
    lines = []
    none = [sight.name for sight in sights if not sight.pictures]
    alone = [s.name for number, s in enumerate(sights) if s.pictures and number not in used]
    if none:
        lines.append(f"pictures in which no sphere is found: {', '.join(none[:5])} ({len(none)})")
    if alone:
        lines.append(f"spheres in pictures that no sweep shows at this pose: {', '.join(alone[:5])} ({len(alone)})")
    return tuple(lines)


def build(options: BodyOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return Kuemmerle(options)


_BALLS = "targets=sphere&place=yard&boards=3&frames_per_scene=3&width_px=621&height_px=350&right=false&lidar=os1-64"
METHOD = p2o.Method(
    name="kuemmerle",
    build=build,
    options=BodyOptions,
    summary="Balls of known size: contours in the picture as cones, spheres in the sweep, one least squares on both.",
    needs=frozenset({"targets"}),
    cite="Kuemmerle and Kuehner, Unified intrinsic and extrinsic camera and LiDAR calibration under uncertainties, "
    "ICRA 2020",
    example=p2o.Example(f"synthetic:?{_BALLS}", "10deg 0.3m", "0.5deg 0.04m", joint=True),
)
