"""A drive is watched: a slip is noticed soon, on its axis and by its size, and noise alone raises no alarm."""

from __future__ import annotations

import numpy as np
import pytest
from p2o.confidence.audit import EdgeStep
from p2o.confidence.watch import Rule, watched
from p2o.results.evidence import Agreement

SIGMA = np.array([0.15, 0.2, 0.12, 0.04, 0.05, 0.05])
MET = Agreement(0.5, 0.1, 1000, 100)


def drive(frames: int, seed: int, correlation: float = 0.3, usual: float = 0.0) -> list[np.ndarray]:
    """Errors (6,) of single frames that follow each other, about a bias of so many deviations."""
    rng = np.random.default_rng(seed)
    values, out = rng.standard_normal(6), []
    for _ in range(frames):
        values = correlation * values + np.sqrt(1 - correlation**2) * rng.standard_normal(6)
        out.append((values + usual) * SIGMA)
    return out


def steps(errors: list[np.ndarray]) -> list[EdgeStep | None]:
    return [EdgeStep(np.eye(4), error, np.diag(SIGMA**2), MET, 100) for error in errors]


def names(count: int) -> list[str]:
    return [f"{number:04d}" for number in range(count)]


def test_noise_that_is_as_it_is_taken_to_be_raises_hardly_any_alarm() -> None:
    """Twenty drives of 500 frames are a third of the frames from one false alarm to the next at one an hour."""
    rule = Rule(alarms_per_hour=1.0, settle=100)
    assert Rule(alarms_per_hour=0.01).limit > rule.limit
    alarms = sum(len(watched(names(500), steps(drive(500, seed)), rule).slips) for seed in range(20))
    assert alarms <= 3
    # Nor does a bias that was there from the beginning.
    rule = Rule(settle=60)
    alarms = [len(watched(names(400), steps(drive(400, seed, usual=1.5)), rule).slips) for seed in range(5)]
    assert sum(alarms) <= 1


@pytest.mark.parametrize(("axis", "number", "size"), [("yaw", 2, 0.3), ("pitch", 1, -0.5), ("x", 3, 0.08)])
def test_a_slip_is_noticed_on_its_axis_with_its_size_and_its_beginning(axis: str, number: int, size: float) -> None:
    errors = drive(300, 7)
    for error in errors[150:]:
        error[number] += size
    found = watched(names(300), steps(errors), Rule())
    first = found.slips[0]
    assert first.axis == axis
    assert 150 <= first.noticed < 190
    assert first.noticed_frame == f"{first.noticed:04d}"
    assert abs(first.began - 150) < 15
    assert first.size == pytest.approx(size, abs=4 * first.sigma)
    assert np.sign(first.size) == np.sign(size)
    assert len(found.slips) == 1
    assert len(found.frames) == 300


def test_frames_that_tell_nothing_leave_the_charts_as_they_are_and_more_frames_detect_smaller_slips() -> None:
    told = steps(drive(60, 3))
    told[40] = None
    found = watched(names(60), told, Rule())
    assert found.frames[40].level is None
    assert found.frames[41].level is not None
    few, some, many = (
        [one.size for one in watched(names(n), steps(drive(n, 1)), Rule(settle=20)).detectable] for n in (22, 80, 400)
    )
    assert few == [None] * 6
    assert all(a is not None and b is not None and a >= b for a, b in zip(some, many, strict=True))


@pytest.mark.parametrize(("number", "count"), [(0, 400), (3, 120)])
def test_slips_of_the_detectable_size_are_detected_in_about_half_of_the_drives(number: int, count: int) -> None:
    rule = Rule(settle=60, alarms_per_hour=1.0)
    size = watched(names(count), steps(drive(count, 0)), rule).detectable[number].size
    assert size is not None

    def share(factor: float) -> float:
        found = 0
        for seed in range(20):
            errors = drive(count, seed)
            for error in errors[60:]:
                error[number] += factor * size
            found += bool(watched(names(count), steps(errors), rule).slips)
        return found / 20

    assert share(0.4) < 0.35
    assert 0.2 <= share(1.0) <= 0.98
    assert share(2.0) >= 0.9
