"""Rounds of matching and solving keep the pose of the lowest judged cost, and shrink the cutting distance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from p2o import JudgeBase, Solution, Status, se3
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import End, Rounds
from p2o.solving import Objective


def at(x_m: float) -> np.ndarray:
    return se3.make(translation=[x_m, 0, 0])


class FromOrigin(JudgeBase):
    """A judge whose cost is the distance of a pose from the origin."""

    name, unit = "distance", "m"

    def costs(self, poses: Sequence[np.ndarray]) -> list[float]:
        return [float(np.linalg.norm(pose[:3, 3])) for pose in poses]

    def on(self, views: Any) -> FromOrigin:
        return self


def ended(places_m: Sequence[float], start_m: float = 3.0, reaches: list[float] | None = None, **options: Any) -> End:
    """Run rounds from a start whose solver returns these places in turn; `reaches` takes the cutting distances."""
    places = iter(places_m)

    def match(views: Any, pose: np.ndarray, reach_px: float) -> Objective:
        if reaches is not None:
            reaches.append(reach_px)
        return Objective(lambda poses: np.zeros(len(poses)))

    rounds = Rounds(
        match,  # type: ignore[arg-type]
        lambda problem, pose: Solution(at(next(places)), 0.0, 1),
        PipelineOptions(**{"rounds": len(places_m), **options}),
    )
    return rounds([], at(start_m), at(start_m), FromOrigin(), reach_px=50.0)


@pytest.mark.parametrize(
    ("places_m", "best_m", "accepted"),
    [
        ((2.0, 1.0, 0.5), 0.5, [True, True, True]),
        ((2.0, 4.0, 1.0), 1.0, [True, False, True]),
        ((1.0, 2.0, 1.5), 1.0, [True, False, False]),
        ((4.0, 5.0, 6.0), 3.0, [False, False, False]),
    ],
)
def test_the_pose_of_the_lowest_cost_is_kept(places_m: tuple[float, ...], best_m: float, accepted: list[bool]) -> None:
    end = ended(places_m)
    assert end.pose[0, 3] == best_m
    assert [turn.accepted for turn in end.rounds] == accepted
    assert [turn.cost for turn in end.rounds] == list(places_m)
    assert end.status is Status.ROUNDS_SPENT


def test_the_cutting_distance_shrinks_to_its_smallest_value_where_rounds_end_once_the_pose_stays() -> None:
    reaches: list[float] = []
    ended((2.0, 1.0, 0.5, 0.25), reaches=reaches, shrink=0.4, min_reach_px=5.0)
    assert reaches == pytest.approx([50.0, 20.0, 8.0, 5.0, 5.0])
    end = ended((1.0, 1.0, 1.0, 1.0), rounds=10, shrink=0.2, min_reach_px=5.0)
    # 50, 10 and 5 px: the pose stays from the second round on, and the third is the first at 5 px.
    assert (end.status, len(end.rounds)) == (Status.CONVERGED, 3)


@pytest.mark.parametrize("moves_m", [(0.0, 0.0), (5e-5, -5e-5)])
def test_an_initial_guess_that_no_round_moves_is_no_result(moves_m: tuple[float, ...]) -> None:
    end = ended([3.0 + move for move in moves_m])
    assert end.status is Status.NO_IMPROVEMENT
    assert end.pose[0, 3] == 3.0
    assert "no pose of lower cost" in end.reason
