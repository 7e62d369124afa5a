"""Figures of calibrations: counts, errors with intervals over groups, coverage, false accepts, paired comparisons."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from p2o import se3
from p2o.geometry.perturb import parse_perturbation
from p2o.results.result import Status
from p2o.results.verdict import Trust
from p2o_study.row import Row
from p2o_study.statistics import (
    NOT_RUN,
    Interval,
    Statistics,
    by_drive,
    by_label,
    compared,
    interval,
    is_worse,
    is_wrong,
    pooled,
    top_groups,
)
from p2o_study.study import parse_study
from p2o_study.summary import summarised
from p2o_study.tables import terminal_text

from tests.fake_study import TRUTH, run_of

BOUNDS = {
    "predicted_rotation_deg": 0.2,
    "predicted_translation_m": 0.06,
    "predicted_rotation_deg_95": 0.4,
    "predicted_translation_m_95": 0.12,
}
STUDY = parse_study(
    'name = "s"\ntitle = "S"\n[[dataset]]\nname = "kitti"\ndata = "d:"\n[[row]]\nlabel = "a"\ncalibrator = "quick"'
)


def run(rotation_deg: float = 0.3, translation_m: float = 0.05, frame: str = "f", seed: int = 0, **values: Any) -> Row:
    """Return a trusted result with these errors."""
    values = {"trust": Trust.TRUSTED, "figures": BOUNDS, **values}
    return run_of(values.pop("row", "a"), frame, seed, rotation_deg, translation_m, **values)


def yawed(angle_deg: float) -> Row:
    """Return a result with a yaw error of this sign and size."""
    turn = se3.exp(np.array([0, np.radians(angle_deg), 0, 0, 0, 0]))
    about = se3.make(TRUTH[:3, :3]).T @ turn @ se3.make(TRUTH[:3, :3])
    return run(estimate=TRUTH @ se3.make(about[:3, :3]))


def test_errors_of_opposite_signs_do_not_cancel() -> None:
    figures = Statistics([yawed(yaw) for yaw in (-0.4, 0.1, 0.3, -0.2, 1.0)])
    for metric in ("yaw_deg", "rotation_deg"):
        mean, median = figures.mean(metric), figures.median(metric)
        assert mean is not None
        assert median is not None
        assert mean.value == pytest.approx(0.4, abs=1e-9)
        assert median.value == pytest.approx(0.3, abs=1e-9)
    assert sorted(figures.signed("yaw_deg")) == pytest.approx([-0.4, -0.2, 0.1, 0.3, 1.0], abs=1e-9)


def test_a_calibration_without_a_known_error_is_counted_and_not_averaged() -> None:
    figures = Statistics([run(0.5), run(truth=None)])
    assert (figures.count, figures.average("rotation_deg"), figures.complete) == (2, pytest.approx(0.5), False)
    unknown = Statistics([run(truth=None)])
    assert unknown.mean("x_m") is None
    assert math.isnan(unknown.average("x_m"))


def test_refused_calibrations_have_the_error_of_their_initial_guess_and_crashed_ones_none() -> None:
    refused = run(status="no-edges", trust=Trust.REFUSED)
    crashed = run(status="stage-failed", trust=None)
    figures = Statistics([run(1.0), refused, refused, crashed], waiting=2)
    assert (figures.count, figures.solved, figures.crashed) == (4, 1, 1)
    assert figures.failures == {"no-edges": 2, "stage-failed": 1, NOT_RUN: 2}
    assert figures.trust == {Trust.TRUSTED: 1, Trust.REFUSED: 2}
    assert figures.errors("rotation_deg") == pytest.approx([1.0, 2.0, 2.0], abs=1e-6)
    assert figures.solved_only.average("rotation_deg") == pytest.approx(1.0, abs=1e-6)


def test_rows_of_the_table_are_kept_apart_in_their_order() -> None:
    rows = [run(row="b"), run(), run(row="b")]
    assert [(label, len(own)) for label, own in by_label(rows).items()] == [("b", 2), ("a", 1)]


@pytest.mark.parametrize(
    ("rotation_deg", "translation_m", "within", "worse"),
    [(0.499, 0.099, 1, 0), (0.51, 0.1, 0, 0), (0.5, 0.11, 0, 0), (2.1, 0.0, 0, 1), (0.0, 0.3, 0, 1)],
)
def test_limits_and_the_initial_guess_bound_rotation_and_translation_each(
    rotation_deg: float, translation_m: float, within: int, worse: int
) -> None:
    row = run(rotation_deg, translation_m)
    figures = Statistics([row], within=parse_perturbation("0.5deg,0.1m"))
    assert (figures.reached, figures.worse) == (within, worse)
    assert is_worse(row) == bool(worse)
    assert not is_worse(replace(row, status=Status.NO_EDGES, estimate=None))


@pytest.mark.parametrize(
    ("moved_m", "status", "unmoved"),
    [(0.0, "converged", 1), (5e-5, "rounds-spent", 1), (0.01, "converged", 0), (0.0, "no-improvement", 0)],
)
def test_a_result_that_is_its_initial_guess_is_counted(moved_m: float, status: str, unmoved: int) -> None:
    row = run(status=status, start=TRUTH, estimate=se3.make(translation=[moved_m, 0, 0]) @ TRUTH)
    assert Statistics([row]).unmoved == unmoved


# ---- intervals


def test_seeds_of_one_frame_do_not_narrow_the_interval() -> None:
    """Closed form: repeating every value 20 times leaves the distribution of resampled frames as it is."""
    sizes = np.random.default_rng(3).gamma(2.0, 0.3, 12)
    once = [run(size, frame=f"f{i}") for i, size in enumerate(sizes)]
    repeated = [run(size, frame=f"f{i}", seed=seed) for i, size in enumerate(sizes) for seed in range(20)]
    single, many = (Statistics(rows).mean("rotation_deg") for rows in (once, repeated))
    assert single is not None
    assert many is not None
    assert single.low is not None
    assert (many.value, many.low, many.high) == pytest.approx((single.value, single.low, single.high), abs=1e-6)
    assert single.low < np.mean(sizes) < (single.high or 0)


def test_groups_are_frames_or_drives_and_distinct_frames_are_counted() -> None:
    rows = [run(frame=f"drive_{i % 2}/{i}", seed=seed) for i in range(6) for seed in range(3)]
    rows.append(run(frames=("drive_0/0", "drive_0/9"), joint=2))
    assert (Statistics(rows).groups, Statistics(rows).frames) == (7, 7)
    drives = Statistics(rows, group_of=by_drive)
    assert drives.groups == 2
    mean = drives.mean("rotation_deg")
    assert mean is not None
    assert mean.low is None, "too few groups for an interval"


def test_intervals_do_not_depend_on_order_and_need_five_groups() -> None:
    values, names = [3.0, 1.0, 2.0, 5.0, 4.0], list("abcde")
    whole = interval(values, names, "median")
    assert whole == interval(values[::-1], names[::-1], "median")
    assert interval(values[:4], names[:4], "mean") == Interval(2.75)
    assert interval([], [], "mean") is None
    with pytest.raises(ValueError, match="frames"):
        interval(values, names[:2], "mean")


def test_intervals_that_overlap_share_a_group_also_through_a_third_one() -> None:
    means = [Interval(3.0, 2.5, 3.5), Interval(1.0, 0.5, 1.5), Interval(1.8, 1.4, 2.2), Interval(2.1, 1.9, 2.3)]
    assert top_groups([*means, Interval(0.1), None]) == [2, 1, 1, 1, None, None]


# ---- bounds and verdicts


def test_rotations_and_translations_are_compared_each_with_its_own_bounds() -> None:
    """The first exceeds its 67 % bound in rotation only; the second both bounds of both; the third none."""
    figures = Statistics([run(), run(0.5, 0.2), run(0.199, 0.059)])
    assert [figures.coverage.within[name.removeprefix("predicted_")] for name in BOUNDS] == [1, 2, 2, 2]
    assert figures.coverage.count == 3
    assert figures.outside_95.runs == 1
    assert Statistics([run(0.5, 0.2, trust=Trust.DOUBTFUL)]).outside_95.runs == 0


def test_a_row_without_a_bound_or_a_truth_is_not_counted_and_an_infinite_bound_covers() -> None:
    rows = [run(status="no-edges"), run(figures={}), run(truth=None)]
    assert (Statistics(rows).coverage.count, Statistics([]).coverage.count) == (0, 0)
    boundless = run(3.0, figures={**BOUNDS, "predicted_rotation_deg": math.inf, "predicted_rotation_deg_95": math.inf})
    assert Statistics([boundless]).coverage.within["rotation_deg"] == 1
    assert Statistics([boundless]).outside_95.runs == 0


def test_a_false_accept_is_a_trusted_result_with_a_large_error_in_either() -> None:
    turned, shifted, right = run(1.01), run(0.1, 0.31), run(0.99, 0.29)
    doubted = replace(turned, trust=Trust.DOUBTFUL)
    rows = [run(), turned, shifted, doubted, right, replace(turned, trust=None)]
    assert Statistics(rows).false_accepts.runs == 2
    assert [is_wrong(row) for row in rows] == [False, True, True, True, False, True]


def test_limits_are_over_distinct_frames_and_exact() -> None:
    """Five initial guesses of one frame are one trial; with k of n the limit is a quantile of the beta distribution."""
    from scipy.stats import beta

    rows = [run(frame=f"f{i}", seed=seed) for i in range(20) for seed in range(5)]
    none = Statistics(rows).false_accepts
    assert (none.runs, none.frames, none.out_of) == (0, 0, 20)
    assert none.limit == pytest.approx(beta.ppf(0.95, 1, 20))
    assert str(none) == "0 (< 14 %)"
    wrong = [run(1.5, frame="f3", seed=seed) for seed in (5, 6)]
    assert str(Statistics([*rows, *wrong]).false_accepts) == "2 (1 of 20)"
    assert str(Statistics([run(trust=Trust.DOUBTFUL)]).outside_95) == "0"


def test_the_error_per_axis_is_the_mean_size_over_three_axes() -> None:
    figures = Statistics([run(0.6, 0.2), run(0.3, 0.1, frame="g")])
    axes = [figures.errors(axis) for axis in ("roll_deg", "pitch_deg", "yaw_deg")]
    assert figures.average("axis_deg") == pytest.approx(np.mean(axes))
    assert figures.average("axis_deg") < figures.average("rotation_deg")
    shifts = [figures.errors(axis) for axis in ("x_m", "y_m", "z_m")]
    assert figures.average("axis_m") == pytest.approx(np.mean(shifts))


def test_the_terminal_table_states_verdicts_and_coverage_by_row_and_of_all_rows_below() -> None:
    text = terminal_text(summarised(STUDY, [run(), run(1.5, frame="w", row="b")]))
    head, a, b, *below = text.splitlines()
    for title, cells in (
        ("false accepts", ("0 (< 95 %)", "1 (1 of 1)")),
        ("outside 95 %", ("0 (< 95 %)", "1 (1 of 1)")),
        ("coverage 67 %", ("0/1 1/1",) * 2),
        ("coverage 95 %", ("1/1 1/1", "0/1 1/1")),
    ):
        end = head.index(title) + len(title)
        assert all(line[:end].endswith(f"  {cell}") for line, cell in zip((a, b), cells, strict=True)), title
    assert below == [
        "Coverage of the predicted errors of 2 runs: 0 % of rotations and 100 % of translations (67 % expected), "
        "50 % of rotations and 100 % of translations (95 % expected)",
        "Trusted: 2 runs, 1 (1 of 2) of them with an error above 1 deg or 30 cm, 1 (1 of 2) outside their own 95 % "
        "bound (in brackets: distinct frames)",
    ]


def test_a_study_without_verdicts_has_no_such_columns() -> None:
    bare = run(trust=None, figures={})
    text = terminal_text(summarised(STUDY, [bare]))
    assert "coverage" not in text.lower()
    assert "rusted" not in text
    assert pooled([bare]) == []


# ---- pairs


def test_two_rows_are_compared_on_their_common_frames_and_seeds() -> None:
    sizes = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    first = [run(size, frame=f"f{i}") for i, size in enumerate(sizes)]
    second = [run(size + (0.25 if i else 0.0), frame=f"f{i}", row="b") for i, size in enumerate(sizes)]
    pair = compared(Statistics(first, "a"), Statistics([*second, run(frame="alone", row="b")], "b"))
    assert pair is not None
    difference = pair.differences["rotation_deg"]
    assert (pair.row, pair.against, pair.pairs, pair.other_start) == ("a", "b", 6, False)
    assert difference.median.value == pytest.approx(-0.25, abs=1e-6)
    assert (difference.better, difference.tied) == (pytest.approx(5 / 6), pytest.approx(1 / 6))
    other = Statistics([run(1.0, frame="f0", protocol="1deg")], "c")
    apart = compared(Statistics(first, "a"), other)
    assert apart is not None
    assert apart.other_start
    assert compared(Statistics(first, "a"), Statistics([run(frame="none")], "d")) is None
