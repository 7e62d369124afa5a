"""Directed edges and mutual information of reflectance together, `--calibrator cues`: a trial of ours, not a rival.

The study `rivals` shows that directed edges and mutual information err in other ways: edges are sure across outlines,
information is vague but looks at every point. So the pose of P2O-Calib is refined by both,

    1/2 d^T (w^2 C)^-1 d - n / a MI(d),

with d the left update of the pose, C its covariance as pairs of edges show it, w how much larger errors are than that,
n the points in the picture, a how many of them tell no more than one, and MI that of `mi` in nats. This is the most
probable pose where edges and points err independently. w and a were chosen on `train` frames; docs/comparison.md
has what came of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import left_from_chart, pose_at

from p2o_baselines import grey, mi, reflectance

_SCALE = np.array([1e-3] * 3 + [1e-2] * 3)
"""Units of the search: radians and metres in which a cost changes about alike."""


class CuesOptions(p2o.Options):
    """Options of `cues`."""

    extractor: str = p2o.field("p2ornet/rings", help="IMAGE/CLOUD that find directed edges.")
    weights: str = p2o.field("", help="Weights of p2ornet, as its option of that name; empty: its default.")
    alike: float = p2o.field(200.0, gt=0, help="So many points of a sweep tell no more than one of them would alone.")
    widen: float = p2o.field(5.0, gt=0, help="Errors of edges are so many times what their pairs show.")
    bins: int = p2o.field(32, ge=2, le=1024, help="Levels of grey, and of reflectance.")


@dataclass(frozen=True, eq=False)
class Seen:
    """What is kept of a frame: a view with directed edges, and one with the picture's grey and the sweep's points."""

    edges: p2o.View
    looks: p2o.View


@dataclass(frozen=True, eq=False)
class _Sum:
    """The sum of both terms around a pose (4, 4), over d (6,) in units of `_SCALE`."""

    pose: Float
    weight: Float
    information: p2o.Objective
    count: float

    def cost(self, scaled: Float) -> float:
        d = scaled * _SCALE
        found = float(self.information.cost(pose_at(self.pose, d)[None])[0])
        return float(0.5 * d @ self.weight @ d + self.count * found)

    def slope(self, scaled: Float) -> Float:
        d = scaled * _SCALE
        assert self.information.gradient is not None
        by_update = self.information.gradient(pose_at(self.pose, d))
        return np.asarray((self.weight @ d + self.count * left_from_chart(d).T @ by_update) * _SCALE)


@dataclass(frozen=True, eq=False)
class Cues:
    """The whole method: P2O-Calib's pipeline, and what the points tell besides."""

    options: CuesOptions
    pipeline: p2o.Pipeline
    grey: p2o.ImageExtractor
    points: p2o.CloudExtractor
    information: p2o.Matcher

    def prepare(self, frame: p2o.Frame) -> Seen:
        """Return the features of a frame."""
        looks = p2o.View(frame.name, frame.camera, self.grey(frame.image), self.points(frame.cloud))
        return Seen(self.pipeline.prepare(frame), looks)

    def solve(self, prepared: Sequence[Seen], camera_from_lidar: Float) -> p2o.Result:
        """Return the pose by edges, refined by both; that of the edges where they give no covariance."""
        result = self.pipeline.solve([seen.edges for seen in prepared], camera_from_lidar)
        if not result.status.solved or result.covariance is None:
            return result
        pose = result.camera_from_lidar
        twists = {motion.frame: np.array(motion.twist) for motion in result.motions}
        views = [
            seen.looks.untwisted(twists[seen.looks.name]) if seen.looks.name in twists else seen.looks
            for seen in prepared
        ]
        both = _Sum(
            pose,
            np.linalg.inv(result.covariance * self.options.widen**2),
            self._objective(views, pose),
            sum(_in_picture(view, pose) for view in views) / self.options.alike,
        )
        if not both.count:
            return replace(result, warnings=(*result.warnings, "no point of the sweep lies in the picture"))
        return self._refined(result, both)

    def _objective(self, views: Sequence[p2o.View], pose: Float) -> p2o.Objective:
        problem = self.information(views, pose, 0.0)
        assert isinstance(problem, p2o.Objective)
        return problem

    def _refined(self, result: p2o.Result, both: _Sum) -> p2o.Result:
        from scipy.optimize import minimize

        found = minimize(both.cost, np.zeros(6), jac=both.slope, method="BFGS", options={"maxiter": 60, "gtol": 1e-3})
        if not found.fun < both.cost(np.zeros(6)):
            return result
        pose = pose_at(both.pose, found.x * _SCALE)
        step = pose @ p2o.se3.inverse(both.pose)
        moved = f"points moved it by {p2o.se3.angle_deg(step):.3f} deg and {p2o.se3.distance_m(step):.3f} m"
        return replace(result, camera_from_lidar=pose, reason=f"{result.reason}; {moved}")


def _in_picture(view: p2o.View, pose: Float) -> int:
    points = view.get("cloud-points")
    assert isinstance(points, p2o.CloudPoints)
    return int(view.camera.in_image(view.camera.project(p2o.se3.apply(pose, points.xyz))).sum())


def build(options: CuesOptions) -> p2o.Calibrator:
    """Return the calibrator; raises a P2OError for an extractor or a setting that is not there."""
    settings = {"extractor": {"weights": options.weights}} if options.weights else {}
    recipe = p2o.Recipe.of(extractor=options.extractor, matcher="ogm", options=settings, witness="none")
    pipeline = recipe.resolve(p2o.Registry.load()).calibrator()
    if not isinstance(pipeline, p2o.Pipeline):
        raise p2o.InputError("the edges come from a pipeline", got=options.extractor)
    return Cues(
        options,
        pipeline,
        grey.METHOD.build(grey.METHOD.options()),
        reflectance.METHOD.build(reflectance.METHOD.options()),
        mi.build(mi.MiOptions(bins=options.bins)),
    )


METHOD = p2o.Method(
    name="cues",
    build=build,
    options=CuesOptions,
    summary="P2O-Calib's edges and mutual information of reflectance and grey together: a trial of ours.",
    needs={"intensity"},
    cite="Wang et al., P2O-Calib, IROS 2023; Pandey et al., AAAI 2012",
    example=p2o.Example("synthetic:?place=street", "1deg 0.05m", "0.3deg 0.1m"),
)
