"""What a report says follows from the single runs in the store, and the same store gives the same report."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from p2o import InputError, Registry, UnknownNameError
from p2o.cli import main
from p2o.page.plot import Panel
from p2o.results.figures import figure_lines
from p2o.results.verdict import Trust
from p2o_study.report import write_report
from p2o_study.report.bootstrap import MIN_FRAMES, interval
from p2o_study.report.figures import figures_of
from p2o_study.report.series import Histories, differ_much, lifted
from p2o_study.report.summary import Measured, summarise_study
from p2o_study.report.tables import latex, markdown
from p2o_study.report.worst import outcome_text, worst_run
from p2o_study.store import Planned, Store, StoredRow, StoredStudy
from p2o_study.study import Published

from tests.fake_study import PLUGIN, PUBLISHED, planned, rounds, run_of, staged, table2, write_store
from tests.page_description import blocks, column, description, table, texts

STUDY = StoredStudy("table2", 'title = "T"', {}, ())


def frames(count: int, row: str, errors: list[float], **values: object) -> list[StoredRow]:
    """Return runs of `count` frames, with one seed for each error."""
    return [run_of(row, f"f{i}", seed, e, 0.1, **values) for i in range(count) for seed, e in enumerate(errors)]


# ---- intervals


def test_the_value_of_an_interval_is_the_mean_or_median_of_all_runs() -> None:
    values, names = [1.0, 2.0, 3.0, 10.0], ["a", "b", "c", "d"]
    assert interval(values, names, "mean").value == 4.0
    assert interval(values, names, "median").value == 2.5
    assert interval(values[:3], names[:3], "median").value == 2.0


def test_a_median_of_weighted_values_is_that_of_the_values_repeated() -> None:
    """An odd and an even number of runs a frame, drawn several times: numpy's median of the written-out sample."""
    from p2o_study.report.bootstrap import _statistics

    rng = np.random.default_rng(0)
    values = np.sort(rng.normal(size=9))
    weights = rng.integers(0, 4, (50, 9))
    weights[:, 3] += 1
    for statistic, of in (("mean", np.mean), ("median", np.median)):
        expected = [of(np.repeat(values, w)) for w in weights]
        assert np.allclose(_statistics(values, np.arange(9), weights, statistic), expected, rtol=1e-12)


def test_a_median_of_drawn_frames_is_that_of_all_runs_of_each_drawn_frame() -> None:
    """Frames with different numbers of runs, enough for several blocks of values."""
    from p2o_study.report.bootstrap import _statistics

    rng = np.random.default_rng(2)
    values, frame = np.sort(rng.normal(size=150)), rng.integers(0, 12, 150)
    draws = rng.multinomial(12, np.full(12, 1 / 12), 40).astype(np.uint8)
    for statistic, of in (("mean", np.mean), ("median", np.median)):
        expected = [of(np.repeat(values, drawn[frame])) for drawn in draws]
        assert np.allclose(_statistics(values, frame, draws, statistic), expected, rtol=1e-12)


def test_frames_that_all_say_the_same_leave_no_doubt() -> None:
    """Seeds differ and frames do not: whichever frames are drawn, the mean stays."""
    names = [f"f{i}" for i in range(8) for _ in range(2)]
    found = interval([1.0, 3.0] * 8, names, "mean")
    assert (found.low, found.value, found.high) == (2.0, 2.0, 2.0)


def test_more_seeds_of_the_same_frames_do_not_narrow_an_interval() -> None:
    """A frame's error twice is no second frame; drawn as runs, the interval would shrink by sqrt(4)."""
    errors = np.random.default_rng(1).gamma(2.0, size=20)
    names = [f"f{i}" for i in range(20)]
    once = interval(errors, names, "mean")
    fourfold = interval(np.repeat(errors, 4), np.repeat(names, 4).tolist(), "mean")
    assert np.isclose(fourfold.low, once.low, rtol=1e-12)
    assert np.isclose(fourfold.high, once.high, rtol=1e-12)


def test_the_interval_of_a_mean_is_as_wide_as_normal_theory_says() -> None:
    """Half a width of 1.96 sigma / sqrt(n), n = 400; 2000 draws of a quantile and sigma are good for a tenth."""
    sample = np.random.default_rng(2).normal(5.0, 2.0, 400)
    found = interval(sample, [str(i) for i in range(400)], "mean")
    expected = 1.96 * sample.std() / 20
    assert np.isclose(found.high - found.value, expected, rtol=0.1)
    assert np.isclose(found.value - found.low, expected, rtol=0.1)


def test_intervals_do_not_depend_on_the_order_of_runs() -> None:
    rng = np.random.default_rng(3)
    values, names = rng.normal(size=60), np.repeat([f"f{i}" for i in range(12)], 5)
    order = rng.permutation(60)
    for statistic in ("mean", "median"):
        assert interval(values, names.tolist(), statistic) == interval(values[order], names[order].tolist(), statistic)


def test_few_frames_have_no_interval_and_no_runs_no_value() -> None:
    few = [f"f{i % (MIN_FRAMES - 1)}" for i in range(40)]
    assert interval(np.arange(40.0), few, "mean").low is None
    assert interval([], [], "mean") is None
    with pytest.raises(ValueError, match="frames"):
        interval([1.0], ["a", "b"], "mean")


# ---- rows


def test_a_row_has_the_figures_of_its_runs() -> None:
    runs = frames(6, "ours", [0.5, 1.5])
    [group] = summarise_study(STUDY, runs).groups
    [row] = group.rows
    assert isinstance(row, Measured)
    assert (row.runs, len(row.places), row.seeds, row.failures) == (12, 6, 2, {})
    assert np.isclose(row.mean["rotation_deg"].value, 1.0)
    assert np.isclose(row.mean["translation_m"].value, 0.1)
    # The axis of `run_of`, (2, 1, -2) / 3 in the LiDAR frame: roll about its x, pitch about its -y, yaw about its -z.
    assert np.isclose(row.mean["roll_deg"].value, 2 / 3)
    assert np.isclose(row.mean["pitch_deg"].value, 1 / 3)


def test_errors_by_axis_are_absolute_in_tables() -> None:
    """Turns of 1 and -1 degree cancel in the signed mean, not in the absolute one."""
    [group] = summarise_study(STUDY, frames(6, "ours", [1.0, -1.0])).groups
    assert np.isclose(group.measured[0].mean["roll_deg"].value, 2 / 3)


def test_a_refused_run_counts_with_its_error_and_among_the_failures() -> None:
    runs = frames(5, "ours", [1.0])
    runs[0] = replace(runs[0], status="too-few-matches", rotation_deg=2.0)
    [row] = summarise_study(STUDY, runs).groups[0].measured
    assert row.failures == {"too-few-matches": 1}
    assert np.isclose(row.mean["rotation_deg"].value, (4 * 1.0 + 2.0) / 5)
    assert row.complete


def test_what_came_near_the_truth_and_what_went_away_from_it_is_counted_where_the_study_asks() -> None:
    """Starts of `frames` are 2 deg off; of the runs below one is near, one far, one worse, one refused at its start."""
    near, far, worse, refused = (frames(1, "ours", [size])[0] for size in (0.4, 1.5, 2.5, 0.1))
    refused = replace(refused, status="too-few-matches")
    runs = [replace(run, frames=(f"f{i}",)) for i, run in enumerate((near, far, worse, refused))]
    asking = replace(STUDY, toml='title = "T"\nwithin = "0.5deg 0.15m"')
    summary = summarise_study(asking, runs)
    [row] = summary.groups[0].measured
    assert (row.within, row.worse, row.seconds) == (1, 1, 0.75)
    text = markdown([summary], lambda _: ())
    assert "| not solved | within | worse | time" in text
    assert "| 1 too-few-matches | 1 | 1 | 0.75 |" in text
    assert "| within |" not in markdown([summarise_study(STUDY, runs)], lambda _: ())
    odd = replace(STUDY, toml='title = "T"\nwithin = "what"')
    assert summarise_study(odd, runs).groups[0].measured[0].within is None, "a store may come from anywhere"


def test_coverage_of_predicted_errors_and_false_accepts_are_counted() -> None:
    """Turns of 0.4 and 1.5 deg, likely 0.5 and at most 1.2: one holds each bound, one neither and is over 1 deg."""
    bounds = {"predicted_rotation_deg": 0.5, "predicted_translation_m": 0.2}
    bounds |= {"predicted_rotation_deg_95": 1.2, "predicted_translation_m_95": 0.3}
    runs = frames(1, "ours", [0.4, 1.5], trust=Trust.TRUSTED, figures=bounds)
    summary = summarise_study(STUDY, runs)
    [row] = summary.groups[0].measured
    assert (row.coverage.text_67, row.coverage.text_95, row.false_accepts) == ("1/2 2/2", "1/2 2/2", 1)
    text = markdown([summary], lambda _: ())
    assert "| verdict | false accepts | predicted 67 % | coverage 67 % | coverage 95 % |" in text
    assert "| 2 trusted | 1 | 0.500 deg 20.0 cm | 1/2 2/2 | 1/2 2/2 |" in text
    assert "Trusted: 2 runs, 1 of them with an error above 1 deg or 30 cm" in text
    assert "Trusted: 2 runs" in latex([summary])
    silent = [replace(run, figures={}) for run in runs]
    assert "| coverage 67 % |" not in markdown([summarise_study(STUDY, silent)], lambda _: ())


def test_an_offset_in_time_is_among_the_evidence_of_a_run() -> None:
    figures = {"time_offset_s": 0.0041, "time_sigma_s": 0.0012, "time_use": "corrected"}
    line = ("time", "images later than their timestamps by +4.1 ms, sigma 1.2 ms, corrected")
    assert line in figure_lines(figures)
    assert "time" not in dict(figure_lines({}))


def test_a_run_that_raised_or_is_not_there_makes_a_row_incomplete_and_never_bold() -> None:
    good = frames(6, "good", [1.0])
    nothing = {"rotation_deg": None, "translation_m": None, "status": "stage-failed", "exception": "Traceback"}
    raised = [*frames(6, "raised", [0.1])[1:], replace(frames(6, "raised", [0.1])[0], **nothing)]
    behind = frames(6, "behind", [0.1])
    missing = [Planned("k", "table2", "behind", dataset="kitti")] * 2
    summary = summarise_study(STUDY, [*good, *raised, *behind, *frames(6, "worst", [3.0])], missing)
    rows = {row.label: row for row in summary.groups[0].measured}
    assert rows["raised"].failures == {"stage-failed": 1}
    assert rows["behind"].failures == {"not run": 2}
    assert [label for label, row in rows.items() if row.complete] == ["good", "worst"]
    text = markdown([summary], lambda _: ())
    assert "| good | 2deg 0.15m | 6 | 6 | 0 | 0.75 | **1.000" in text
    assert "| raised | 2deg 0.15m | 6 | 6 | 1 stage-failed | 0.75 | 0.100" in text


def test_a_row_without_truth_is_there_without_figures() -> None:
    runs = [replace(r, rotation_deg=None, translation_m=None, roll_deg=None) for r in frames(6, "ours", [1.0])]
    summary = summarise_study(STUDY, runs)
    assert "rotation_deg" not in summary.groups[0].measured[0].mean
    assert "| ours | 2deg 0.15m | 6 | 6 | 0 | 0.75 | - | - | - | - |" in markdown([summary], lambda _: ())


def test_rows_are_compared_only_within_section_dataset_and_kind() -> None:
    runs = [
        *frames(5, "a", [1.0], section="single"),
        *frames(5, "b", [1.0], section="single"),
        *frames(5, "c", [1.0], section="wide", dataset="kitti"),
        *frames(5, "d", [1.0], section="wide", dataset="streets"),
        run_of("e", "f0", 0, 1.0, 0.1, section="single", joint=5, frames=tuple(f"f{i}" for i in range(5))),
    ]
    groups = summarise_study(STUDY, runs).groups
    assert [(g.heading, list(g.runs)) for g in groups] == [
        ("single, kitti, each frame alone", ["a", "b"]),
        ("wide, kitti", ["c"]),
        ("wide, streets", ["d"]),
        ("single, kitti, jointly solved frames", ["e"]),
    ]
    assert [len(g.comparisons) for g in groups] == [1, 0, 0, 0]


def test_metrics_of_the_study_file_choose_the_columns() -> None:
    summary = summarise_study(replace(STUDY, toml='metrics = ["translation_m", "yaw_deg"]'), frames(5, "a", [1.0]))
    assert (summary.norms, summary.axes) == (("translation_m",), ("yaw_deg",))
    text = markdown([summary], lambda _: ())
    assert "rotation mean" not in text
    assert "| row |  | yaw [deg] |" in text


# ---- pairs


def test_pairs_are_runs_on_the_same_frame_and_seed() -> None:
    """The second row is 0.5 deg better on each frame, but has seed 0 alone, and a frame of its own."""
    first = frames(6, "first", [1.0, 9.0])
    second = [*frames(6, "second", [0.5]), run_of("second", "other", 0, 7.0, 0.1)]
    [pair] = summarise_study(STUDY, [*first, *second]).groups[0].comparisons
    assert (pair.row, pair.against, pair.pairs) == ("second", "first", 6)
    rotation = pair.differences["rotation_deg"]
    assert np.allclose([rotation.median.value, rotation.median.low, rotation.median.high], -0.5)
    assert (rotation.better, rotation.tied) == (1.0, 0.0)
    assert pair.differences["translation_m"].tied > 0.9
    assert not pair.other_start


def test_equal_runs_are_tied_and_other_starts_are_told() -> None:
    runs = [*frames(6, "a", [1.0]), *frames(6, "b", [1.0], perturb="10deg 0.15m")]
    summary = summarise_study(STUDY, runs)
    [pair] = summary.groups[0].comparisons
    assert pair.other_start
    assert (pair.differences["rotation_deg"].better, pair.differences["rotation_deg"].tied) == (0.0, 1.0)
    assert "| b | a (other start) | 6 | +0.000 [+0.000, +0.000] | 0 % (100 % tied) |" in markdown(
        [summary], lambda _: ()
    )


def test_many_rows_are_compared_with_the_best_alone() -> None:
    runs = [run for i in range(8) for run in frames(5, f"row{i}", [abs(i - 3) + 1.0])]
    pairs = summarise_study(STUDY, runs).groups[0].comparisons
    assert {pair.against for pair in pairs} == {"row3"}
    assert len(pairs) == 7


# ---- tables


def test_published_rows_stand_beside_ours_and_are_never_bold() -> None:
    runs = [*frames(6, "ours", [1.0]), *frames(6, "others", [2.0])]
    summary = summarise_study(replace(STUDY, published=PUBLISHED), runs)
    rows = summary.groups[0].rows
    assert [(r.label, isinstance(r, Published)) for r in rows] == [
        ("ours", False),
        ("ours", True),
        ("others", False),
        ("RGGNet", True),
    ]
    lines = [line for line in markdown([summary], lambda _: ()).splitlines() if "published:" in line]
    assert len(lines) == 2, "they give no errors by axis"
    assert not any("**" in line for line in lines)
    assert lines[0].startswith("| *ours (published: P2O-Calib, Table 2)* | 2 deg, 0.15 m | - |")
    assert "| - | *0.001* | - |" in lines[0]
    assert "**1.000 [1.000, 1.000]**" in markdown([summary], lambda _: ()), "ours is the best measured row"


def test_errors_by_axis_have_a_mean_and_a_median_beside_what_is_published() -> None:
    """Of five yaws of 1 deg and one of 7 the mean is 2, the median 1; the published 1.5 lies between them."""
    runs = [
        replace(r, yaw_deg=e, roll_deg=0.1) for r, e in zip(frames(6, "a", [1.0]), [-1, 1, 1, 1, -1, 7], strict=True)
    ]
    published = {"label": "theirs", "source": "x", "beside": "a", "values": {"roll_deg": 0.2, "yaw_deg": 1.5}}
    toml = 'metrics = ["roll_deg", "pitch_deg", "yaw_deg"]'
    text = markdown([summarise_study(replace(STUDY, toml=toml, published=(published,)), runs)], lambda _: ())
    table = text.partition("**Absolute errors by axis")[2]
    assert table.startswith(" (1 of 2 means at or under the published ones)**")
    mean, median, theirs = [[c.strip() for c in line.split("|")[1:-1]] for line in table.splitlines()[4:7]]
    assert [mean[0], mean[1], mean[4].split()[0]] == ["a", "mean", "2.000"]
    assert [median[0], median[1], median[4].split()[0]] == ["", "median", "1.000"]
    assert theirs[1:] == ["mean", "*0.200*", "-", "*1.500*"]
    assert "theirs" not in text.partition("**Absolute errors by axis")[0], "it gives no norms"


def test_a_published_row_stands_below_its_row_on_every_dataset() -> None:
    runs = [*frames(5, "ours @ a", [1.0], dataset="a"), *frames(5, "ours @ b", [1.0], dataset="b")]
    groups = summarise_study(replace(STUDY, published=PUBLISHED[1:]), runs).groups
    assert [[type(row).__name__ for row in g.rows] for g in groups] == [["Measured", "Published"]] * 2


def test_markdown_rows_have_as_many_cells_as_their_head_whatever_they_are_called() -> None:
    hostile = "a|b *c* `d` <script> \\ _e_"
    summary = summarise_study(STUDY, [*frames(5, hostile, [1.0]), *frames(5, "plain", [2.0])])
    lines = [line for line in markdown([summary], lambda _: ()).splitlines() if line.startswith("|")]
    counts = [len(re.findall(r"(?<!\\)\|", line)) - 1 for line in lines]
    assert counts == [10] * 4 + [8] * 6 + [7] * 3
    assert "<script>" not in "".join(lines).replace("\\<script\\>", "")


def test_latex_rows_have_as_many_cells_as_columns_and_every_special_letter_is_escaped() -> None:
    hostile = r"[x] 5 % & $k_1$ #{~^\}"
    summary = summarise_study(STUDY, [*frames(5, hostile, [1.0]), *frames(5, "plain", [2.0])])
    text = latex([summary])
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 3
    columns = [len(spec) for spec in re.findall(r"\\begin\{tabular\}\{(\w+)\}", text)]
    for count, body in zip(columns, re.findall(r"\\toprule\n(.*?)\\bottomrule", text, re.DOTALL), strict=True):
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert [len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows] == [count] * len(rows)
        assert not any(row.startswith("[") for row in rows), "a length of the line break before it"
    assert r"{}[x] 5 \% \& \$k\_1\$ \#\{\textasciitilde{}\textasciicircum{}\textbackslash{}\}" in text
    assert r"\textbf{1.000 [1.000, 1.000]}" in text


def test_verdicts_are_counted_in_tables_where_there_are_any() -> None:
    """Of six runs two are ambiguous and one was refused; the other row is of a store that knew no verdicts."""
    words = [Trust.TRUSTED] * 3 + [Trust.AMBIGUOUS] * 2 + [Trust.REFUSED]
    known = [replace(run, trust=word) for run, word in zip(frames(6, "known", [1.0]), words, strict=True)]
    summary = summarise_study(replace(STUDY, published=PUBLISHED), [*known, *frames(6, "unknown", [2.0])])
    lines = [[c.strip() for c in line.split("|")[1:-1]] for line in markdown([summary], lambda _: ()).splitlines()]
    [head] = [line for line in lines if "not solved" in line]
    place = head.index("verdict")
    cells = {line[0]: line[place] for line in lines if len(line) == len(head)}
    assert cells["known"] == "3 trusted, 2 ambiguous, 1 refused"
    assert cells["unknown"] == "-"
    assert cells["*RGGNet (published: Yuan et al. 2020)*"] == "-"
    assert "verdict" in latex([summary]).partition(r"\midrule")[0]
    nothing = summarise_study(STUDY, frames(6, "unknown", [2.0]))
    assert "| verdict |" not in markdown([nothing], lambda _: ())


def test_costs_that_are_not_finite_are_no_figures(tmp_path: Path) -> None:
    first, second = rounds((900, 18.0))
    run = run_of(
        "a", "f0", 0, 1.0, 0.1, rounds=(first, replace(second, cost=math.inf), replace(second, mean_residual=math.inf))
    )
    assert Histories.of([run]).convergence().residual_px.tolist() == [[18.0]] * 3
    figures = {"judge": "directed-distance", "cost_unit": "px", "cost_initial": math.inf, "cost_result": None}
    html = write_report(write_store(tmp_path, [replace(run, figures=figures)]))[0].read_text()
    assert "inf px at the initial guess, by directed-distance" in html


# ---- figures


def test_a_run_that_has_ended_keeps_its_last_round() -> None:
    """Three runs of 3, 2 and 1 rounds: in the third round the medians are over all three."""
    histories = [[(900, 18.0), (400, 4.0), (300, 1.0)], [(800, 16.0), (500, 3.0)], [(700, 14.0)]]
    runs = [run_of("a", f"f{i}", 0, 1.0, 0.1, rounds=rounds(*h)) for i, h in enumerate(histories)]
    found = Histories.of(runs).convergence()
    assert found.runs == 3
    assert found.matches[1].tolist() == [800, 500, 500]
    assert found.residual_px[1].tolist() == [16, 4, 3]
    assert Histories.of([run_of("a", "f", 0, 1.0, 0.1, rounds=rounds())]).convergence() is None


def panels_of(kind: str, runs: list[StoredRow]) -> list[Panel]:
    """Return the panels of a figure of a study."""
    [figure] = [figure for name, _, figure in figures_of(summarise_study(STUDY, runs)) if name == f"table2-{kind}"]
    return list(figure.panels)


def test_a_box_shows_the_quartiles_of_the_signed_errors() -> None:
    turns = [-3.0, -1.5, 0.0, 1.5, 3.0]
    roll = panels_of("boxplot", [run_of("a", f"f{i}", 0, turn, 0.1) for i, turn in enumerate(turns)])[0]
    assert (roll.x.title, roll.y.names) == ("roll [deg]", ["a"])
    assert np.allclose(roll.series[0].x, [[-2, -1, 0, 1, 2]]), "2/3 of the turns"


def test_an_axis_is_logarithmic_where_the_medians_of_rows_are_more_than_twenty_times_apart() -> None:
    """Sizes count, not signs; a row of zeros or without values has no say."""
    near, far = np.array([-1.0, 1.0, 1.0]), np.array([-20.0, 20.0])
    assert not differ_much([near, far])
    assert differ_much([near, 1.01 * far])
    assert not differ_much([1.01 * far])
    assert not differ_much([near, np.zeros(3), np.array([]), np.array([np.nan])])
    assert [row.tolist() for row in lifted([np.array([0.0, -2.0]), np.array([0.0])])] == [[2.0, 2.0], [2.0]]


@pytest.mark.parametrize(("factor", "scale"), [(10, "linear"), (25, "log")])
def test_boxes_of_rows_that_differ_much_are_on_one_logarithmic_axis_without_signs(factor: int, scale: str) -> None:
    turns = [-3.0, -1.5, 0.0, 1.5, 3.0]
    rows = [("a", 1), ("b", factor)]
    runs = [run_of(row, f"f{i}", 0, times * turn, 0.1) for row, times in rows for i, turn in enumerate(turns)]
    panels = panels_of("boxplot", runs)
    angles, lengths = panels[:3], panels[3:]
    assert {panel.x.log for panel in angles} == {scale == "log"}
    assert not any(panel.x.log for panel in lengths), "their shifts are alike"
    assert len({(panel.x.low, panel.x.high) for panel in angles}) == 1
    if scale == "log":
        assert angles[0].x.title == "|roll| [deg]", "nothing is beyond the axis"
        assert angles[0].series[1].x[0][4] == 2 * factor, "the largest roll is 2/3 of the turn of 3 deg"
    else:
        assert angles[0].x.low == -angles[0].x.high


def test_rounds_are_logarithmic_where_rows_end_far_from_each_other() -> None:
    ends = {"a": [(900, 18.0), (400, 0.1)], "b": [(900, 18.0), (500, 3.0)]}
    runs = [run_of(row, "f", 0, 1.0, 0.1, rounds=rounds(*history)) for row, history in ends.items()]
    assert [panel.y.log for panel in panels_of("convergence", runs)] == [False, True]


def test_points_beyond_the_axes_are_counted_in_its_title() -> None:
    runs = [run_of("a", f"f{i}", 0, 0.1 * (i % 5), 0.1) for i in range(20)] + [run_of("a", "x", 0, 90.0, 0.1)]
    assert panels_of("boxplot", runs)[0].x.title == "roll [deg]; 1 of 21 runs beyond"


def test_frames_are_shown_with_the_median_and_range_of_their_seeds() -> None:
    [series] = panels_of("frames", frames(3, "a", [1.0, 2.0, 4.0]))[0].series
    assert np.allclose([series.low, series.x, series.high], [[1, 1, 1], [2, 2, 2], [4, 4, 4]])


def test_hundreds_of_frames_are_ranked() -> None:
    [series] = panels_of("frames", [run_of("a", f"f{i}", 0, 0.5 + i / 2, 0.1) for i in range(200)])[0].series
    assert np.allclose(series.x, 0.5 + np.arange(200) / 2)
    assert list(series.y) == list(range(1, 201))


def test_names_are_no_formulas() -> None:
    """matplotlib reads $...$ as mathematics and refuses what is none."""
    pytest.importorskip("matplotlib")
    runs = frames(5, r"$\nonsense{$", [1.0])
    from p2o.page.figure import drawn, figure_files

    for _, _, figure in figures_of(summarise_study(replace(STUDY, toml="title = '$x$ $\\frac$'"), runs)):
        assert figure_files(drawn(figure))["png"].startswith(b"\x89PNG")


# ---- the worst run of a row


def test_the_worst_run_has_the_largest_turn_then_the_worst_verdict_and_is_the_first_of_equals() -> None:
    one, far, equal = frames(3, "a", [1.0])[0], *frames(2, "a", [4.0])
    raised = replace(one, rotation_deg=None, status="stage-failed")
    assert worst_run([raised, one, far, equal]) is far
    assert worst_run([raised]) is raised
    unknown = [replace(one, rotation_deg=None, trust=word) for word in (None, Trust.DOUBTFUL, Trust.TRUSTED)]
    assert worst_run(unknown) is unknown[1]


BOUND = {"figures": {"predicted_rotation_deg_95": 0.75, "predicted_translation_m_95": 0.25}}


@pytest.mark.parametrize(
    ("turn", "values", "said"),
    [
        (
            1.5,
            {"trust": Trust.TRUSTED, **BOUND},
            "The error is still large: 1.50 deg and 10.0 cm; error of the initial guess: 2.00 deg and 15.0 cm. "
            "The verdict is trusted, a false accept. The predicted error (95 %) is 0.75 deg and 25.0 cm, less than "
            "the error.",
        ),
        (
            2.5,
            {"trust": Trust.DOUBTFUL, "why": "edges agree at random"},
            "The result is worse than the initial guess: error 2.50 deg and 10.0 cm; error of the initial guess: "
            "2.00 deg and 15.0 cm. The verdict is doubtful: edges agree at random.",
        ),
        (
            0.5,
            {"trust": Trust.TRUSTED, **BOUND},
            "The result is good: error 0.50 deg and 10.0 cm; error of the initial guess: 2.00 deg and 15.0 cm. The "
            "verdict is trusted. The predicted error (95 %) is 0.75 deg and 25.0 cm, which covers the error.",
        ),
        (
            2.0,
            {"status": "too-few-matches", "reason": "12 pairs"},
            "The run was refused (too-few-matches): 12 pairs. The result is the initial guess, error 2.00 deg and "
            "10.0 cm.",
        ),
        (
            1.0,
            {"status": "stage-failed", "reason": "", "exception": "Traceback\nNo luck\n"},
            "The run raised: No luck.",
        ),
        (
            1.0,
            {"rotation_deg": None, "translation_m": None, "trust": Trust.AMBIGUOUS, "why": "", **BOUND},
            "The error is unknown: there is no ground truth. The verdict is ambiguous. The predicted error (95 %) is "
            "0.75 deg and 25.0 cm.",
        ),
    ],
)
def test_the_outcome_of_a_run_is_described_in_words(turn: float, values: dict[str, object], said: str) -> None:
    assert outcome_text(replace(run_of("a", "f", 0, turn, 0.1), **values)) == said


def test_the_median_predicted_error_of_a_row_is_in_its_tables() -> None:
    """Runs of 0.2, 0.3 and 0.7 deg say so; one that was refused promises nothing, nor does the second row."""
    sizes = (0.2, 0.3, 0.7, 9.0)
    predicted = [{"predicted_rotation_deg": size, "predicted_translation_m": size / 10} for size in sizes]
    runs = [run_of("a", f"f{i}", 0, 1.0, 0.1, figures=values) for i, values in enumerate(predicted)]
    runs[3] = replace(runs[3], status="no-edges")
    summary = summarise_study(STUDY, [*runs, *frames(3, "b", [1.0])])
    assert [dict(row.predicted) for row in summary.groups[0].measured] == [
        {"rotation_deg": 0.3, "translation_m": pytest.approx(0.03)},
        {},
    ]
    lines = [[c.strip() for c in line.split("|")[1:-1]] for line in markdown([summary], lambda _: ()).splitlines()]
    [head] = [line for line in lines if "not solved" in line]
    cells = {line[0]: line[head.index("predicted 67 %")] for line in lines if len(line) == len(head)}
    assert (cells["a"], cells["b"]) == ("0.300 deg 3.0 cm", "-")


# ---- the whole report


@pytest.fixture
def blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write empty figures, in tests of other parts of a report: drawing takes most of its time."""
    monkeypatch.setattr("p2o.page.figure.drawn", lambda figure: None)
    monkeypatch.setattr("p2o.page.figure.figure_files", lambda figure: {"png": b"", "svg": b""})


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """The files of a report, in the folder `report` of its store."""
    return tuple(write_report(write_store(tmp_path_factory.mktemp("study"), table2(6, 2))))


def test_a_report_has_tables_figures_and_a_page(reported: tuple[Path, ...]) -> None:
    names = {path.name for path in reported}
    [folder] = {path.parent for path in reported}
    assert folder.name == "report"
    assert {p.name for p in folder.iterdir()} == names
    figures = {f"table2-{g}-{kind}" for g in (1, 2) for kind in ("boxplot", "convergence", "frames")}
    assert names == {"report.html", "report.md", "report.tex"} | {f"{f}.{e}" for f in figures for e in ("png", "svg")}
    text = (folder / "report.md").read_text()
    assert set(re.findall(r"\]\(([^)]*)\)", text)) == {f"{f}.png" for f in figures}
    for figure in figures:
        ElementTree.parse(folder / f"{figure}.svg")


def test_the_same_store_gives_the_same_bytes_in_any_process(reported: tuple[Path, ...], tmp_path: Path) -> None:
    store = reported[0].parents[1]
    command = [sys.executable, "-m", "p2o", "report", str(store), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    for path in reported:
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), path.name


@pytest.mark.usefixtures("blank_figures")
def test_the_command_names_what_it_wrote(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_store(tmp_path, table2(3, 1))
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "x"), "--study", "table2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == str(tmp_path / "x" / "report.html")
    assert all(Path(line).is_file() for line in lines)


def test_the_command_explains_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "--help"]) == 0
    assert capsys.readouterr().out.startswith("Usage: p2o report")


@pytest.mark.usefixtures("blank_figures")
def test_only_the_studies_that_are_named_are_reported(tmp_path: Path) -> None:
    write_store(tmp_path, table2(3, 1))
    write_store(tmp_path, [run_of("a", "f", 0, 1.0, 0.1, study="other")], toml='title = "The other"')
    write_report(tmp_path, tmp_path / "one", studies=["other"])
    write_report(tmp_path, tmp_path / "both")
    assert "Table 2: KITTI" not in (tmp_path / "one" / "report.md").read_text()
    both = (tmp_path / "both" / "report.md").read_text()
    assert both.index("The other") < both.index("Table 2: KITTI"), "by name"


# ---- pictures


def drawn(folder: Path, *words: str) -> int:
    return main(["report", str(folder), "--plugin", PLUGIN, "--data", *words])


def pictures_in(folder: Path) -> list[list[dict[str, str]]]:
    """Return the overlays that each run of a page opens with."""
    runs = table(description(folder / "report" / "report.html"), "runs")
    return [blocks(opened, "slides") for opened in runs["opens"]]


@pytest.mark.usefixtures("blank_figures")
def test_pictures_are_drawn_from_the_users_data_worst_frames_first(tmp_path: Path) -> None:
    import base64

    import cv2

    write_store(tmp_path, staged())
    assert drawn(tmp_path, "fake:?frames=3", "--overlays", "2") == 0
    shown = pictures_in(tmp_path)
    assert [len(p) for p in shown] == [0, 1, 1, 0, 1, 1], "the two worst of three frames, in each row"
    assert shown[1][0]["name"] == "drive/0001"
    uris = {one[end] for some in shown for one in some for end in ("left", "right")}
    html = (tmp_path / "report" / "report.html").read_text()
    assert html.count("data:image/jpeg") == len(uris) == 4, "each is there once: two of the edges, two of the sweep"
    assert shown[1][0]["left"].partition(",")[0] == "data:image/jpeg;base64"
    before, after = (
        cv2.imdecode(np.frombuffer(base64.b64decode(shown[1][0][end].partition(",")[2]), np.uint8), 1)
        for end in ("left", "right")
    )
    assert before.shape == after.shape
    assert (np.abs(before.astype(int) - after) > 40).any(), "0.3 m aside moves the edges"


@pytest.mark.usefixtures("blank_figures")
def test_without_data_there_are_numbers_and_no_pictures(tmp_path: Path) -> None:
    write_report(write_store(tmp_path, staged()))
    assert pictures_in(tmp_path) == [[]] * 6


@pytest.mark.usefixtures("blank_figures")
def test_joint_runs_show_each_of_their_frames(tmp_path: Path) -> None:
    names = ("drive/0000", "drive/0001")
    one = replace(staged()[0], frames=names, joint=2)
    write_store(tmp_path, [one])
    assert drawn(tmp_path, "fake:") == 0
    assert [[p["name"] for p in shown] for shown in pictures_in(tmp_path)] == [list(names)]


@pytest.mark.usefixtures("blank_figures")
def test_progress_names_each_frame_and_figure_in_turn(tmp_path: Path) -> None:
    write_store(tmp_path, staged())
    told: list[tuple[str, int, int]] = []
    registry = Registry.load(extra_files=[PLUGIN], environ={})
    write_report(
        tmp_path, data=["fake:?frames=3"], registry=registry, on_progress=lambda *said: told.append(said), overlays=2
    )
    frames = [said for said in told if said[0].startswith("drive/")]
    assert frames == [(f"drive/{frame}", done, 4) for done, frame in enumerate(["0002", "0001", "0002", "0001"])]
    titles = [said for said in told if said not in frames]
    assert [(done, total) for _, done, total in titles] == [(0, 3), (1, 3), (2, 3)]
    assert told == [*frames, *titles]


@pytest.mark.usefixtures("blank_figures")
def test_progress_is_shown_on_a_terminal_alone_and_not_when_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_store(tmp_path, table2(1, 1))
    for terminal, words, some in ((True, [], True), (True, ["--quiet"], False), (False, [], False)):
        with monkeypatch.context() as patch:
            patch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
            assert main(["report", str(tmp_path), *words]) == 0
        assert ("drawing" in capsys.readouterr().err) is some, (terminal, words)


# ---- what can be wrong


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that a command is refused with."""
    assert main(words) == 2
    captured = capsys.readouterr()
    [line] = captured.err.splitlines()
    assert captured.out == ""
    return line


def test_a_folder_without_a_store_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "the store is missing" in refused(["report", str(tmp_path / "nothing")], capsys)
    assert not (tmp_path / "nothing").exists()


def test_an_empty_store_and_a_study_without_runs_are_told(tmp_path: Path) -> None:
    Store.open(tmp_path).close()
    with pytest.raises(InputError, match=r"the store has no study with a finished run.*p2o ablate STUDY"):
        write_report(tmp_path)
    write_store(tmp_path, [], missing=[planned(table2(1, 1)[0])])
    with pytest.raises(InputError, match=r"study 'table2' has no finished run yet.*p2o ablate table2"):
        write_report(tmp_path)
    assert not (tmp_path / "report").exists()


def test_an_unknown_study_is_told_with_the_nearest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_store(tmp_path, table2(1, 1))
    line = refused(["report", str(tmp_path), "--study", "tabel2"], capsys)
    assert "unknown study 'tabel2'" in line
    assert "did you mean table2?" in line


def test_a_folder_that_cannot_be_written_is_told_before_any_work(tmp_path: Path) -> None:
    write_store(tmp_path, table2(1, 1))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write the report"):
        write_report(tmp_path, tmp_path / "file" / "out")


def test_frames_that_the_data_lack_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_store(tmp_path, staged())
    line = refused(["report", str(tmp_path), "--plugin", PLUGIN, "--data", "fake:?frames=1"], capsys)
    assert "2 of 3 frames of dataset 'fake' are missing from the data; expected drive/0002, ...; got 1 frames" in line
    assert not (tmp_path / "report" / "report.html").exists()


def test_frames_with_other_content_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [replace(run, inputs={run.frames[0]: {"image": "0" * 64}}) for run in staged()]
    write_store(tmp_path, runs)
    line = refused(["report", str(tmp_path), "--plugin", PLUGIN, "--data", "fake:?frames=3"], capsys)
    assert "the image of this frame differs from that of the study" in line


@pytest.mark.parametrize("text", ["streets=fake:", "fak=fake:"])
def test_a_dataset_that_no_study_has_is_told(text: str, tmp_path: Path) -> None:
    write_store(tmp_path, staged())
    with pytest.raises(UnknownNameError, match="expected one of: fake"):
        write_report(tmp_path, data=[text])


def test_of_several_datasets_one_has_to_be_named(tmp_path: Path) -> None:
    other = run_of("other", "f", 0, 1.0, 0.1, dataset="streets")
    write_store(tmp_path, [*staged(), other])
    with pytest.raises(InputError, match="NAME=DATASET:PATH with a NAME of fake, streets"):
        write_report(tmp_path, data=["fake:"])


@pytest.mark.usefixtures("blank_figures")
def test_a_page_has_the_worst_runs_of_each_row_and_plots_of_all_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page of 100,000 runs would have 136 MB."""
    from p2o_study.report import page

    monkeypatch.setattr(page, "_RUN_BYTES", 40_000)
    monkeypatch.setattr(page, "_MOST_POINTS", 10)
    runs = table2(12, 3)
    data = description(write_report(write_store(tmp_path, runs))[0])
    shown = table(data, "runs")
    assert 3 < len(shown["rows"]) < 108
    assert shown["counted"] == " runs, the worst of each row; all 108 runs are in study.sqlite"
    assert len(json.dumps(shown["opens"])) < 200_000
    boxes, by_frame = (blocks(data, "plot")[number]["panels"][0] for number in (0, 2))
    worst = table(data, "worst")
    for row, label in enumerate(column(table(data, "rows"), "row")[:3]):
        errors = [run.rotation_deg for run in runs if run.row == label]
        [box] = [one for one in boxes["series"] if one["name"] == label and one.get("form") == "box"]
        assert np.isclose(box["x"][0][2], np.median(errors), rtol=1e-5)
        pairs = zip(column(shown, "row"), column(shown, "rotation"), strict=True)
        own = [error for name, error in pairs if name == label]
        assert np.allclose(sorted(own), sorted(errors)[-len(own) :], rtol=1e-5)
        assert column(shown, "rotation")[worst["opens"][row]["row"]] == max(own)
    assert len(by_frame["y"]["names"]) == 3, "ten points of three rows"


def test_a_page_has_the_first_of_very_many_rows() -> None:
    from p2o_study.report import page
    from p2o_study.report.overlays import OverlayImages

    runs = [run_of(f"row {i}", "f", 0, 1.0, 0.1) for i in range(450)]
    data = description(page.page([summarise_study(STUDY, runs)], OverlayImages()))
    assert "This page has the first 400 of 450 rows; report.md has all." in texts(data)
    assert column(table(data, "rows"), "row") == [f"row {i}" for i in range(400)]


def test_a_brief_row_of_a_store_is_completed_to_the_row_itself(tmp_path: Path) -> None:
    with Store.open(write_store(tmp_path, table2(3, 2))) as store:
        rows, brief = store.rows("table2"), list(store.brief_rows("table2"))
        assert all(run.estimate is None and not run.recipe for run in brief)
        for row, run in zip(rows, store.completed(brief), strict=True):
            for name in StoredRow.__dataclass_fields__:
                assert np.array_equal(getattr(row, name), getattr(run, name)), name
