"""Combine directed edges and mutual information of reflectance, `--calibrator cues`: an experiment of ours.

The study `rivals` shows that the errors of directed edges and mutual information are independent: edges are precise
across outlines, information is imprecise but uses every point. The pose of P2O-Calib is therefore refined by both,

    1/2 d^T (w^2 C)^-1 d - n / a MI(d),

with d the left update of the pose, C its covariance from the edge pairs, w the ratio of the actual errors to C, n the
number of points in the image, a the number of points per independent observation, and MI the mutual information of `mi`
in nats. The minimum is the most probable pose if errors of edges and points are independent. w and a were chosen on
`train` frames; docs/comparison.md has the results.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import p2o
from p2o import Float, field
from p2o.solving import Objective, Pipeline, left_from_chart, pose_from_chart
from pydantic import ValidationInfo, field_validator

from p2o_baselines.information import grey, mi, reflectance

_SCALE = np.array([1e-3] * 3 + [1e-2] * 3)  # rad and m that change a cost by about the same amount
_BINS = 32  # levels of grey, and of reflectance
_POINTS_PER_OBSERVATION = 200.0  # points of a sweep per independent observation


class CuesOptions(p2o.Options):
    """Options of `cues`."""

    extractor: str = field("p2ornet/rings", help="IMAGE/CLOUD that find directed edges.")
    weights: str = field("", help="Weights of p2ornet, as its option of that name; empty: its default.")

    @field_validator("weights")
    @classmethod
    def _default(cls, value: str, info: ValidationInfo) -> str:
        """Record the weights that P2O_WEIGHTS selects, because they alter the result."""
        is_own = info.data.get("extractor", "").startswith("p2ornet/")
        return value or (os.environ.get("P2O_WEIGHTS", "") if is_own else "")


@dataclass(frozen=True, eq=False)
class Seen:
    """What is kept of a frame: a view with directed edges, and one with the image's grey and the sweep's points."""

    edges: p2o.View
    looks: p2o.View


@dataclass(frozen=True, eq=False)
class _Sum:
    """The sum of both terms around a pose (4, 4), over d (6,) in units of `_SCALE`."""

    pose: Float
    weight: Float
    information: Objective
    count: float

    def cost(self, scaled: Float) -> float:
        d = scaled * _SCALE
        value = float(self.information.cost(pose_from_chart(self.pose, d)[None])[0])
        return float(0.5 * d @ self.weight @ d + self.count * value)

    def slope(self, scaled: Float) -> Float:
        d = scaled * _SCALE
        assert self.information.gradient is not None
        by_update = self.information.gradient(pose_from_chart(self.pose, d))
        return np.asarray((self.weight @ d + self.count * left_from_chart(d).T @ by_update) * _SCALE)


@dataclass(frozen=True, eq=False)
class Cues:
    """The calibrator: the pipeline of P2O-Calib with an additional information term."""

    options: CuesOptions
    pipeline: Pipeline
    grey: p2o.ImageExtractor
    points: p2o.CloudExtractor
    information: p2o.Matcher

    def prepare(self, frame: p2o.Frame) -> Seen:
        """Return the features of a frame."""
        looks = p2o.View(frame.name, frame.camera, self.grey(frame.image), self.points(frame.cloud))
        return Seen(self.pipeline.prepare(frame), looks)

    def solve(self, prepared: Sequence[Seen], camera_from_lidar: Float) -> p2o.Result:
        """Return the pose of the edges refined by both cues; that of the edges alone if it has no covariance."""
        result = self.pipeline.solve([seen.edges for seen in prepared], camera_from_lidar)
        if not result.status.solved or result.covariance is None:
            return result
        pose = result.camera_from_lidar
        twists = {motion.frame: np.array(motion.twist) for motion in result.motions}
        looks = (seen.looks for seen in prepared)
        views = [each.untwisted(twists[each.name]) if each.name in twists else each for each in looks]
        both = _Sum(
            pose,
            np.asarray(np.linalg.inv(result.covariance)),
            self._objective(views, pose),
            sum(_in_picture(view, pose) for view in views) / _POINTS_PER_OBSERVATION,
        )
        if not both.count:
            return replace(result, warnings=(*result.warnings, "no point of the sweep is in the image"))
        return self._refined(result, both)

    def _objective(self, views: Sequence[p2o.View], pose: Float) -> Objective:
        problem = self.information(views, pose, 0.0)
        assert isinstance(problem, Objective)
        return problem

    def _refined(self, result: p2o.Result, both: _Sum) -> p2o.Result:
        from scipy.optimize import minimize

        minimum = minimize(both.cost, np.zeros(6), jac=both.slope, method="BFGS", options={"maxiter": 60, "gtol": 1e-3})
        if not minimum.fun < both.cost(np.zeros(6)):
            return result
        pose = pose_from_chart(both.pose, minimum.x * _SCALE)
        step = pose @ p2o.se3.inverse(both.pose)
        moved = f"points moved it by {p2o.se3.angle_deg(step):.3f} deg and {p2o.se3.distance_m(step):.3f} m"
        return replace(result, camera_from_lidar=pose, reason=f"{result.reason}; {moved}")


def _in_picture(view: p2o.View, pose: Float) -> int:
    points = view.get("cloud-points")
    assert isinstance(points, p2o.CloudPoints)
    return int(view.camera.in_image(view.camera.project(p2o.se3.apply(pose, points.xyz))).sum())


def _plan(options: CuesOptions) -> Any:
    """Return the plan of the edges."""
    settings = {"extractor": {"weights": options.weights}} if options.weights else {}
    recipe = p2o.Recipe.of(extractor=options.extractor, matcher="ogm", options=settings, witness="none")
    return recipe.resolve(p2o.Registry.load())


def build(options: CuesOptions) -> p2o.Calibrator:
    """Return the calibrator; raises a P2OError for an unknown extractor or setting."""
    pipeline = _plan(options).calibrator()
    if not isinstance(pipeline, Pipeline):
        raise p2o.InputError("the edges must come from a pipeline", got=options.extractor)
    return Cues(
        options,
        pipeline,
        grey.extract,
        reflectance.METHOD.build(reflectance.METHOD.options()),
        mi.build(mi.MiOptions(bins=_BINS)),
    )


METHOD = p2o.Method(
    name="cues",
    build=build,
    data_licence=lambda options: _plan(options).licences().get("extractor", ""),
    options=CuesOptions,
    summary="Combines the edges of P2O-Calib with mutual information of reflectance and grey (experimental).",
    needs={"intensity"},
    cite="Wang et al., P2O-Calib, IROS 2023; Pandey et al., AAAI 2012",
    example=p2o.Example("synthetic:?place=street", "1deg 0.05m", "0.3deg 0.1m"),
)
