"""Costs of poses from the information that an image and a sweep share: for mi, nmi and nid."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import p2o
from p2o import Bool, Float, Int
from p2o.solving import Objective

from p2o_baselines.information.histogram import Levels, Measure, Plain, joint_counts

From = TypeVar("From")
Made = TypeVar("Made")


def remembered(make: Callable[[From], Made]) -> Callable[[From], Made]:
    """Return `make` with its results kept as long as its argument lives."""
    known: WeakKeyDictionary[From, Made] = WeakKeyDictionary()

    def look_up(feature: From) -> Made:
        if feature not in known:
            known[feature] = make(feature)
        return known[feature]

    return look_up


_CHUNK, _CELLS = 1 << 17, 1 << 22  # points, and cells of histograms, that are worked on at once
MARGIN_DEG = 5.0
"""Margin around the image of points that are kept, because other poses may project them into the image."""
_MAX_CONDITION = 1e8


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points `xyz` (N, 3) m of one sweep, each with a `row` (N,) of the histogram, and the image that saw them."""

    camera: p2o.Camera
    levels: Levels
    xyz: Float
    row: Int
    rows: int

    def counts(self, poses: Float) -> Float:
        """Return joint histograms (B, R, C) at poses (B, 4, 4) of the points that each of them puts in the image."""
        size = max(1, min(_CHUNK // max(len(self.xyz), 1), _CELLS // (self.rows * self.levels.count)))
        return np.concatenate([self._counts(poses[i : i + size]) for i in range(0, len(poses), size)])

    def _counts(self, poses: Float) -> Float:
        uv = self.camera.project(p2o.se3.apply(poses, self.xyz))
        weight = self.levels.presence(uv)
        uv = np.where(weight[..., None] > 0, uv, 2.0)
        out = np.zeros((len(poses), self.rows, self.levels.count))
        for tap in self.levels.taps(uv):
            out += joint_counts(self.row, tap.level, tap.weight * weight, self.rows, self.levels.count)
        return out

    def scores(self, pose: Float, by_counts: Float, *, fading: bool = True) -> Float:
        """Return each visible point's derivatives (N, 6) by a left update, of a sum with derivatives (R, C).

        With `fading` the weights at the border change with the pose, as in `counts`.
        """
        xyz = p2o.se3.apply(pose, self.xyz)
        uv = self.camera.project(xyz)
        weight, fade = self.levels.presence(uv), self.levels.presence_slope(uv)
        seen = np.flatnonzero(weight > 0)
        _, by_place = self.camera.project_with_jacobian(xyz[seen])
        by_update = np.concatenate([-p2o.se3.skew(xyz[seen]), np.broadcast_to(np.eye(3), (len(seen), 3, 3))], axis=2)
        by_pixel = np.zeros((len(seen), 2))
        for tap in self.levels.taps(uv[seen], slopes=True):
            assert tap.slope is not None
            slope = weight[seen, None] * tap.slope
            if fading:
                slope += tap.weight[:, None] * fade[seen]
            by_pixel += by_counts[self.row[seen], tap.level][:, None] * slope
        out = np.zeros((len(xyz), 6))
        out[seen] = np.einsum("ni,nij,njk->nk", by_pixel, by_place, by_update)
        return out


@dataclass(frozen=True, eq=False)
class Information:
    """The mean of a measure over groups of sweeps; the points of a group are counted in one histogram."""

    groups: tuple[tuple[SeenPoints, ...], ...]
    estimators: tuple[Plain, ...]
    measure: Measure

    def cost(self, poses: Float) -> Float:
        """Return the cost (B,) of poses (B, 4, 4)."""
        poses = np.asarray(poses, np.float64)
        if not self.groups:
            return np.full(len(poses), self.measure.worst)
        parts = zip(self.groups, self.estimators, strict=True)
        return np.asarray(np.mean([self._costs(group, estimator, poses) for group, estimator in parts], axis=0))

    def objective(self) -> Objective:
        """Return the cost as what matchers give."""
        return Objective(self.cost)

    def _costs(self, group: Sequence[SeenPoints], estimator: Plain, poses: Float) -> Float:
        """Return the costs (B,) of one group."""
        size = max(1, _CELLS // (group[0].rows * group[0].levels.count))
        parts = [poses[i : i + size] for i in range(0, len(poses), size)]
        return np.concatenate([self.measure.of(estimator.shares(counts_of(group, part))) for part in parts])


class SmoothInformation(Information):
    """The same for counts that are smooth functions of the pose: with a gradient and the Cramer-Rao bound."""

    def objective(self) -> Objective:
        """Return the cost with its gradient and covariance as what matchers give."""
        return Objective(self.cost, self.gradient, self.covariance)

    def gradient(self, pose: Float) -> Float:
        """Return the derivatives (6,) of the cost by a left update (rad, m) of a pose."""
        out = np.zeros(6)
        for group, estimator in zip(self.groups, self.estimators, strict=True):
            counts = counts_of(group, pose[None])[0]
            by_shares = self.measure.slope(estimator.shares(counts[None])[0])
            by_counts = estimator.slope(counts, by_shares)
            out += sum(part.scores(pose, by_counts).sum(axis=0) for part in group)
        return out / max(len(self.groups), 1)

    def covariance(self, pose: Float) -> Float | None:
        """Return the Cramer-Rao bound (6, 6) of a left update, too low for dependent points; None if singular."""
        fisher = np.zeros((6, 6))
        for group, estimator in zip(self.groups, self.estimators, strict=True):
            shares = estimator.shares(counts_of(group, pose[None]))[0]
            log = np.log(np.maximum(shares, 1e-12))
            for part in group:
                scores = part.scores(pose, log, fading=False)
                fisher += scores.T @ scores
        scale = np.sqrt(np.diagonal(fisher))
        if not (np.isfinite(fisher).all() and (scale > 0).all()):
            return None
        scaled = fisher / np.outer(scale, scale)
        if np.linalg.cond(scaled) > _MAX_CONDITION:
            return None
        bound = np.linalg.inv(scaled) / np.outer(scale, scale)
        return np.asarray((bound + bound.T) / 2)


def counts_of(group: Sequence[SeenPoints], poses: Float) -> Float:
    """Return the joint histograms (B, R, C) of all sweeps of a group together."""
    return np.asarray(np.sum([part.counts(poses) for part in group], axis=0))


# ---- selection of points


@dataclass(frozen=True, eq=False)
class Sighting:
    """What one view has for these costs: grey values, and points with the values that go with them, (N,)."""

    camera: p2o.Camera
    grey: p2o.GreyMap
    xyz: Float
    value: Float

    def select(self, keep: Bool | Int) -> Sighting:
        """Return the sighting with the points of a mask or index."""
        return Sighting(self.camera, self.grey, self.xyz[keep], self.value[keep])

    def near_image(self, pose: Float, most: int, margin_deg: float = MARGIN_DEG) -> Sighting:
        """Return the points in the image at a pose or within a margin of it, `most` of them spread evenly."""
        margin_px = self.camera.focal_px * float(np.tan(np.radians(margin_deg)))
        uv = self.camera.project(p2o.se3.apply(pose, self.xyz))
        near = np.flatnonzero(self.camera.in_image(uv, margin_px))
        if len(near) > most:
            near = near[np.linspace(0, len(near) - 1, most).round().astype(np.int64)]
        return self.select(near)

    def visible(self, pose: Float, cell_px: float, slack_m: float) -> Sighting:
        """Return the visible points at a pose: those at most `slack_m` behind the nearest of a cell."""
        xyz = p2o.se3.apply(pose, self.xyz)
        cell = np.floor((self.camera.project(xyz) + 0.5) / cell_px)
        known = np.isfinite(cell).all(axis=1)
        _, number = np.unique(cell[known], axis=0, return_inverse=True)
        distance = np.linalg.norm(xyz, axis=1)
        nearest = np.full(int(number.max(initial=-1)) + 1, np.inf)
        np.minimum.at(nearest, number.ravel(), distance[known])
        keep = np.zeros(len(xyz), np.bool_)
        keep[known] = distance[known] <= nearest[number.ravel()] + slack_m
        return self.select(keep)


def sightings(views: Sequence[p2o.View], value: str = "reflectance") -> Iterator[Sighting]:
    """Yield grey values and points of views with both; `value` is reflectance, or for normals the slope in deg."""
    for view in views:
        grey, points = view.get("image-grey"), view.get("cloud-points")
        if grey is None or points is None or not len(points):
            continue
        if value == "normals":
            if points.normal is None:
                raise p2o.InputError(
                    "the points have no normals",
                    where=view.name,
                    expected="normals of surfaces",
                    got="none",
                    hint="--extractor grey/reflectance --set cloud.normal_neighbours=20",
                )
            slope = np.degrees(np.arccos(np.clip(np.abs(points.normal[:, 2]), 0.0, 1.0)))
            yield Sighting(view.camera, grey, points.xyz, slope)
        elif points.intensity is not None:
            yield Sighting(view.camera, grey, points.xyz, points.intensity)


@dataclass(frozen=True)
class Span:
    """The values that the first and the last level stand for."""

    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[Float]) -> Span:
        """Return the span of values, without the thousandth part at either end."""
        if not values:
            return cls(0.0, 1.0)
        low, high = np.quantile(np.concatenate(values), [0.001, 0.999])
        return cls(float(low), float(high))

    def levels(self, values: Float, count: int) -> Int:
        """Return the levels (N,) from 0 to `count` - 1 of values (N,)."""
        share = (values - self.low) / max(self.high - self.low, 1e-12)
        return np.clip((share * count).astype(np.int64), 0, count - 1)
