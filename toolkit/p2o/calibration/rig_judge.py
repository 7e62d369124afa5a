"""The judge of poses of a LiDAR on a body, by the edges of several cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from p2o.arrays import Float
from p2o.features.view import View
from p2o.host.stages import JudgeBase
from p2o.problems.interval_likelihood import most_likely_near

RIG_STEPS = np.array([*np.radians([0.1, 0.1, 0.1]), 0.02, 0.02, 0.02])
"""Units of the unknowns of the maximisation: 0.1 deg and 2 cm."""


@dataclass(frozen=True, eq=False)
class RigJudge(JudgeBase):
    """Judges poses body_from_lidar by the edges of all cameras: the sum of the edges that a pose loses.

    `places` are camera_from_body (4, 4), `counts` the numbers of views of the cameras.
    """

    places: tuple[Float, ...]
    judges: tuple[JudgeBase, ...]
    counts: tuple[int, ...]
    name: str = "rig"
    unit: str = "edges"

    def costs(self, poses: Sequence[Float]) -> list[float]:
        """Return the cost of each pose in edges, summed over the cameras that can judge all of them."""
        rows = []
        for place, judge in zip(self.places, self.judges, strict=True):
            row = judge.costs([place @ pose for pose in poses])
            if np.isfinite(row).all():
                rows.append([judge.lead(0.0, cost)[0] for cost in row])
        if not rows:
            return [float("inf")] * len(poses)
        costs: list[float] = np.sum(rows, axis=0).tolist()
        return costs

    def maximised(self, pose: Float) -> Float:
        """Return the pose (4, 4) of the local maximum of the sum of likelihoods, if all cameras have one."""
        parts = [(place, judge.log_likelihood) for place, judge in zip(self.places, self.judges, strict=True)]
        known = [(place, likelihood) for place, likelihood in parts if likelihood is not None]
        return most_likely_near(known, pose, RIG_STEPS, 30) if len(known) == len(parts) else pose

    def on(self, views: Sequence[View]) -> RigJudge:
        """Return the judge of the same edges in other `views`, those of all cameras one after the other."""
        ends = np.cumsum([0, *self.counts])
        judges = [judge.on(views[a:b]) for judge, a, b in zip(self.judges, ends[:-1], ends[1:], strict=True)]
        return replace(self, judges=tuple(judges))
