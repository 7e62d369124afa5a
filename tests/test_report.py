"""What a report says follows from the single runs in the store, and the same store gives the same report."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from p2o import InputError, Registry
from p2o.cli import main
from p2o.page.plot import Panel
from p2o.results.verdict import Trust
from p2o_study.report import write_report
from p2o_study.report.figures import convergence_of, figures_of
from p2o_study.row import Row
from p2o_study.rows import PlanRow
from p2o_study.statistics import Statistics, _statistics, error_rank, interval
from p2o_study.study import Published, parse_study
from p2o_study.summary import Summary, summarised
from p2o_study.tables import report_latex, report_markdown

from tests.fake_study import PLUGIN, PUBLISHED, rounds, run_of, staged, table2, toml_of, write_store
from tests.page_description import blocks, column, description, table

HEAD = 'name = "table2"\ntitle = "T"\n'
DATA = '[[dataset]]\nname = "kitti"\ndata = "kitti:"\n'


def summary_of(
    runs: Sequence[Row], missing: Sequence[PlanRow] = (), more: str = "", published: Sequence[Mapping[str, Any]] = ()
) -> Summary:
    """Return the summary of a study of these runs; `more` are further words of its file."""
    study = parse_study(HEAD + more + DATA + toml_of(published))
    return summarised(study, runs, missing)


def markdown(summary: Summary) -> str:
    return report_markdown([summary], lambda _: ())


def cells(text: str, label: str) -> dict[str, str]:
    """Return the cells of the first row of a Markdown table that begins with a label, by their heading."""
    head: list[str] = []
    for line in text.splitlines():
        parts = [part.strip() for part in line.split("|")[1:-1]]
        if parts[:1] == ["row"]:
            head = parts
        if parts[:1] == [label] and "runs" in head:
            return dict(zip(head, parts, strict=True))
    raise AssertionError(label)


def frames(count: int, row: str, errors: list[float], **values: object) -> list[Row]:
    """Return runs of `count` frames, with one seed for each error."""
    return [run_of(row, f"f{i}", seed, e, 0.1, **values) for i in range(count) for seed, e in enumerate(errors)]


# ---- intervals


def test_a_median_of_drawn_frames_is_that_of_all_runs_of_each_drawn_frame() -> None:
    """Frames with different numbers of runs, enough for several blocks of values."""
    rng = np.random.default_rng(2)
    values, frame = np.sort(rng.normal(size=150)), rng.integers(0, 12, 150)
    draws = rng.multinomial(12, np.full(12, 1 / 12), 40).astype(np.uint8)
    for statistic, of in (("mean", np.mean), ("median", np.median)):
        expected = [of(np.repeat(values, drawn[frame])) for drawn in draws]
        assert np.allclose(_statistics(values, frame, draws, statistic), expected, rtol=1e-12)


def test_the_interval_of_a_mean_is_as_wide_as_normal_theory_says() -> None:
    """Half a width of 1.96 sigma / sqrt(n), n = 400; 2000 draws of a quantile and sigma are good for a tenth."""
    sample = np.random.default_rng(2).normal(5.0, 2.0, 400)
    found = interval(sample, [str(i) for i in range(400)], "mean")
    expected = 1.96 * sample.std() / 20
    assert np.isclose(found.high - found.value, expected, rtol=0.1)
    assert np.isclose(found.value - found.low, expected, rtol=0.1)


# ---- rows


def test_a_row_has_the_figures_of_its_runs() -> None:
    [group] = summary_of(frames(6, "ours", [0.5, 1.5])).groups
    [row] = group.rows
    assert isinstance(row, Statistics)
    assert (row.count, row.frames, row.failures) == (12, 6, {})
    assert np.isclose(row.average("rotation_deg"), 1.0)
    assert np.isclose(row.average("translation_m"), 0.1)
    # The axis of `run_of`, (2, 1, -2) / 3 in the LiDAR frame: roll about its x, pitch about its -y, yaw about its -z.
    assert np.isclose(row.average("roll_deg"), 2 / 3)
    assert np.isclose(row.average("pitch_deg"), 1 / 3)


def test_what_reaches_the_limits_and_what_is_worse_is_counted_where_the_study_asks() -> None:
    """Initial errors are 2 deg: of the runs one is within, one outside, one worse, one refused."""
    runs = [run_of("ours", f"f{i}", 0, size, 0.1) for i, size in enumerate((0.4, 1.5, 2.5))]
    runs.append(run_of("ours", "f3", 0, 0.1, 0.1, status="too-few-matches"))
    summary = summary_of(runs, more='within = "0.5deg 0.15m"\n')
    [row] = summary.groups[0].measured
    assert (row.reached, row.worse, row.seconds) == (1, 1, 0.75)
    line = cells(markdown(summary), "ours")
    assert (line["not solved"], line["within"], line["worse"], line["time [s]"]) == ("1", "1", "1", "0.75")
    assert "| within |" not in markdown(summary_of(runs))


def test_coverage_of_predicted_errors_and_false_accepts_are_in_the_tables() -> None:
    """Turns of 0.4 and 1.5 deg, bounds 0.5 and 1.2: one is within each bound, one within none and above 1 deg."""
    bounds = {"predicted_rotation_deg": 0.5, "predicted_translation_m": 0.2}
    bounds |= {"predicted_rotation_deg_95": 1.2, "predicted_translation_m_95": 0.3}
    runs = frames(1, "ours", [0.4, 1.5], trust=Trust.TRUSTED, figures=bounds)
    summary = summary_of(runs)
    line = cells(markdown(summary), "ours")
    assert [line[name] for name in ("trusted", "false accepts", "outside 95 %")] == ["2", "1 (1 of 1)", "1 (1 of 1)"]
    assert [line[name] for name in ("predicted 67 %", "coverage 67 %", "coverage 95 %")] == [
        "0.500 deg 20.0 cm",
        "1/2 2/2",
        "1/2 2/2",
    ]
    assert "Trusted: 2 runs, 1 (1 of 1) of them with an error above 1 deg or 30 cm" in markdown(summary)
    assert "Trusted: 2 runs" not in report_latex([summary])
    silent = [replace(run, figures={}) for run in runs]
    assert "| coverage 67 % |" not in markdown(summary_of(silent))


def test_a_run_that_raised_or_is_not_there_makes_a_row_incomplete_and_one_without_truth_has_no_figures() -> None:
    good, behind, worst = frames(6, "good", [1.0]), frames(6, "behind", [0.1]), frames(6, "worst", [3.0])
    crash = run_of("raised", "f0", 0, 0.1, 0.1, status="stage-failed", exception="Traceback")
    raised = [*frames(6, "raised", [0.1])[1:], crash]
    missing = [PlanRow("behind", "", "kitti", (key,)) for key in "ab"]
    summary = summary_of([*good, *raised, *behind, *worst], missing)
    unknown = summary_of(frames(6, "ours", [1.0], truth=None))
    assert [cells(markdown(unknown), "ours")[name] for name in ("runs", "rotation mean [deg]")] == ["6", "-"]
    rows = {row.label: row for row in summary.groups[0].measured}
    assert rows["raised"].failures == {"stage-failed": 1}
    assert rows["behind"].failures == {"not run": 2}
    assert [label for label, row in rows.items() if row.complete] == ["good", "worst"]
    text = markdown(summary)
    assert cells(text, "good")["rotation mean [deg]"].startswith("**1.000")
    assert cells(text, "raised")["not solved"] == "1 (1 crashed)"
    assert cells(text, "raised")["rotation mean [deg]"].startswith("0.100")
    assert cells(text, "behind")["not solved"] == "0, 2 not run"


def test_rows_are_compared_only_within_section_dataset_and_kind() -> None:
    runs = [
        *frames(5, "a", [1.0], section="single"),
        *frames(5, "b", [1.0], section="single"),
        *frames(5, "c", [1.0], section="wide", dataset="kitti"),
        *frames(5, "d", [1.0], section="wide", dataset="streets"),
        run_of("e", "f0", 0, 1.0, 0.1, section="single", joint=5, frames=tuple(f"f{i}" for i in range(5))),
    ]
    groups = summary_of(runs).groups
    assert [(g.heading, [row.label for row in g.measured]) for g in groups] == [
        ("single, kitti, each frame alone", ["a", "b"]),
        ("wide, kitti", ["c"]),
        ("wide, streets", ["d"]),
        ("single, kitti, jointly solved frames", ["e"]),
    ]
    assert [len(g.comparisons) for g in groups] == [1, 0, 0, 0]


# ---- pairs


def test_equal_runs_are_tied_and_other_starts_are_told() -> None:
    runs = [*frames(6, "a", [1.0]), *frames(6, "b", [1.0], protocol="10deg 0.15m")]
    summary = summary_of(runs)
    [pair] = summary.groups[0].comparisons
    assert pair.other_start
    assert (pair.row, pair.against, pair.pairs) == ("b", "a", 6)
    assert (pair.differences["rotation_deg"].better, pair.differences["rotation_deg"].tied) == (0.0, 1.0)
    assert "| b | a (other start) | 6 | +0.000 [+0.000, +0.000] | 0 % (100 % tied) |" in markdown(summary)


# ---- tables


def test_metrics_of_the_study_file_choose_the_columns() -> None:
    summary = summary_of(frames(5, "a", [1.0]), more='metrics = ["translation_m", "yaw_deg"]\n')
    assert (summary.norms, summary.axes) == (("translation_m",), ("yaw_deg",))
    text = markdown(summary)
    assert "rotation mean" not in text
    assert "| row | yaw mean [deg] |" in text


def test_many_rows_are_compared_with_the_best_alone() -> None:
    runs = [run for i in range(8) for run in frames(5, f"row{i}", [abs(i - 3) + 1.0])]
    pairs = summary_of(runs).groups[0].comparisons
    assert {pair.against for pair in pairs} == {"row3"}
    assert len(pairs) == 7


def test_published_rows_stand_beside_ours_and_are_never_bold() -> None:
    runs = [*frames(6, "ours", [1.0]), *frames(6, "others", [2.0])]
    summary = summary_of(published=PUBLISHED, runs=runs)
    rows = summary.groups[0].rows
    assert [(r.label, isinstance(r, Published)) for r in rows] == [
        ("ours", False),
        ("ours", True),
        ("others", False),
        ("RGGNet", True),
    ]
    errors, _, by_axis = markdown(summary).partition("**Absolute errors by axis")
    lines = [line for line in errors.splitlines() if "published:" in line]
    assert len(lines) == 2
    assert not any("**" in line for line in lines)
    assert lines[0].startswith("| *ours (published: P2O-Calib, Table 2)* | - |")
    assert "| - | *0.001* | - |" in lines[0]
    assert "| - | - | - | - | - | - | *0.001* |" in by_axis, "whether it is an angle or a mean over axes is not stated"
    assert "**1.000 [1.000, 1.000]**" in markdown(summary), "ours is the best measured row"


def test_errors_by_axis_are_means_beside_what_is_published() -> None:
    """Of five turns of 1.5 deg and one of 10.5 the mean roll is 2; the mean over three axes contains two others."""
    runs = [run_of("a", f"f{i}", 0, turn, 0.1) for i, turn in enumerate([-1.5, 1.5, 1.5, 1.5, -1.5, 10.5])]
    published = {"label": "theirs", "source": "x", "beside": "a", "values": {"roll_deg": 1.5, "pitch_deg": 1.2}}
    more = 'metrics = ["roll_deg", "pitch_deg", "yaw_deg"]\n'
    text = markdown(summary_of(runs, more=more, published=(published,)))
    table = text.partition("**Absolute errors by axis")[2]
    head, _, ours, theirs = [[c.strip() for c in line.split("|")[1:-1]] for line in table.splitlines()[2:6]]
    assert head[1:] == [f"{name} mean [deg]" for name in ("roll", "pitch", "yaw", "rotation per axis")]
    means = [float(cell.split()[0]) for cell in ours[1:]]
    assert means[0] == 2.0
    assert means[3] == pytest.approx(np.mean(means[:3]), abs=1e-3)
    assert theirs[1:] == ["*1.500*", "*1.200*", "-", "-"]
    assert "theirs" not in text.partition("**Absolute errors by axis")[0], "it gives no norms"


def test_markdown_rows_have_as_many_cells_as_their_head_whatever_they_are_called() -> None:
    hostile = "a|b *c* `d` <script> \\ _e_"
    summary = summary_of([*frames(5, hostile, [1.0]), *frames(5, "plain", [2.0])])
    lines = [line for line in markdown(summary).splitlines() if line.startswith("|")]
    counts = [len(re.findall(r"(?<!\\)\|", line)) - 1 for line in lines]
    assert counts == [10] * 4 + [9] * 4 + [7] * 3
    assert "<script>" not in "".join(lines).replace("\\<script\\>", "")


def test_latex_rows_have_as_many_cells_as_columns_and_every_special_letter_is_escaped() -> None:
    hostile = r"[x] 5 % & $k_1$ #{~^\}"
    summary = summary_of([*frames(5, hostile, [1.0]), *frames(5, "plain", [2.0])])
    text = report_latex([summary])
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 3
    columns = [len(spec) for spec in re.findall(r"\\begin\{tabular\}\{(\w+)\}", text)]
    for count, body in zip(columns, re.findall(r"\\toprule\n(.*?)\\bottomrule", text, re.DOTALL), strict=True):
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert [len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows] == [count] * len(rows)
        assert not any(row.startswith("[") for row in rows), "a length of the line break before it"
    assert r"{}[x] 5 \% \& \$k\_1\$ \#\{\textasciitilde{}\textasciicircum{}\textbackslash{}\}" in text
    assert r"\textbf{1.000 [1.000, 1.000]}" in text


def test_verdicts_are_counted_in_tables_where_there_are_any() -> None:
    """Of six runs two are ambiguous and one was refused; the other row has no verdicts."""
    words = [Trust.TRUSTED] * 3 + [Trust.AMBIGUOUS] * 2 + [Trust.REFUSED]
    known = [replace(run, trust=word) for run, word in zip(frames(6, "known", [1.0]), words, strict=True)]
    summary = summary_of([*known, *frames(6, "unknown", [2.0])], published=PUBLISHED)
    text = markdown(summary)
    names = ("trusted", "ambiguous", "false accepts")
    assert [cells(text, "known")[name] for name in names] == ["3", "2", r"0 (\< 64 %)"]
    for label in ("unknown", "*RGGNet (published: Yuan et al. 2020)*"):
        assert [cells(text, label)[name] for name in names] == ["-"] * 3
    assert "ambiguous" in report_latex([summary]).partition(r"\midrule")[0]
    assert "| trusted |" not in markdown(summary_of(frames(6, "unknown", [2.0])))


def test_costs_that_are_not_finite_are_no_figures(tmp_path: Path) -> None:
    first, second = rounds((900, 18.0))
    run = run_of(
        "a", "f0", 0, 1.0, 0.1, rounds=(first, replace(second, cost=math.inf), replace(second, mean_residual=math.inf))
    )
    assert convergence_of([run])[1][1].tolist() == [[18.0]] * 3
    figures = {"judge": "directed-distance", "cost_unit": "px", "cost_initial": math.inf, "cost_result": None}
    html = write_report(write_store(tmp_path, [replace(run, figures=figures)]))[0].read_text()
    assert "inf px at the initial guess, by directed-distance" in html


# ---- figures


def test_a_run_that_has_ended_keeps_its_last_round() -> None:
    """Three runs of 3, 2 and 1 rounds: in the third round the medians are over all three."""
    histories = [[(900, 18.0), (400, 4.0), (300, 1.0)], [(800, 16.0), (500, 3.0)], [(700, 14.0)]]
    runs = [run_of("a", f"f{i}", 0, 1.0, 0.1, rounds=rounds(*h)) for i, h in enumerate(histories)]
    count, (matches, residual_px) = convergence_of(runs)
    assert count == 3
    assert matches[1].tolist() == [800, 500, 500]
    assert residual_px[1].tolist() == [16, 4, 3]
    assert convergence_of([run_of("a", "f", 0, 1.0, 0.1, rounds=rounds())]) is None


def panels_of(kind: str, runs: list[Row]) -> list[Panel]:
    """Return the panels of a figure of a study."""
    [figure] = [figure for name, _, figure in figures_of(summary_of(runs)) if name == f"table2-{kind}"]
    return list(figure.panels)


def test_a_box_shows_the_quartiles_of_the_signed_errors() -> None:
    turns = [-3.0, -1.5, 0.0, 1.5, 3.0]
    roll = panels_of("boxplot", [run_of("a", f"f{i}", 0, turn, 0.1) for i, turn in enumerate(turns)])[0]
    assert (roll.x.title, roll.y.names) == ("roll [deg]", ["a (n = 5)"])
    assert np.allclose(roll.series[0].x, [[-2, -1, 0, 1, 2]]), "2/3 of the turns"


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


def test_frames_are_shown_with_the_median_and_range_of_their_seeds() -> None:
    [series] = panels_of("frames", frames(3, "a", [1.0, 2.0, 4.0]))[0].series
    assert np.allclose([series.low, series.x, series.high], [[1, 1, 1], [2, 2, 2], [4, 4, 4]])


def test_points_beyond_the_axes_are_counted_in_its_title() -> None:
    runs = [run_of("a", f"f{i}", 0, 0.1 * (i % 5), 0.1) for i in range(20)] + [run_of("a", "x", 0, 90.0, 0.1)]
    assert panels_of("boxplot", runs)[0].x.title == "roll [deg]; 1 of 21 runs beyond"


def test_of_hundreds_of_frames_those_with_the_largest_errors_are_shown() -> None:
    [series] = panels_of("frames", [run_of("a", f"f{i}", 0, 0.5 + i / 2, 0.1) for i in range(200)])[0].series
    assert np.allclose(series.x, 0.5 + np.arange(120, 200) / 2)


def test_names_are_no_formulas() -> None:
    """matplotlib reads $...$ as mathematics and refuses what is none."""
    pytest.importorskip("matplotlib")
    runs = frames(5, r"$\nonsense{$", [1.0])
    from p2o.page.figure import drawn, figure_files

    for _, _, figure in figures_of(summary_of(runs, more="note = '$x$ $\\frac$'\n")):
        assert figure_files(drawn(figure))["png"].startswith(b"\x89PNG")


# ---- the worst run of a row


def test_the_worst_run_has_the_largest_turn_then_the_worst_verdict_and_is_the_first_of_equals() -> None:
    one, far, equal = frames(3, "a", [1.0])[0], *frames(2, "a", [4.0])
    raised = run_of("a", "f9", 0, 1.0, 0.1, status="stage-failed")
    assert max([raised, one, far, equal], key=error_rank) is far
    unknown = [run_of("a", "f", 0, 1.0, 0.1, truth=None, trust=word) for word in (None, Trust.DOUBTFUL, Trust.TRUSTED)]
    assert max(unknown, key=error_rank) is unknown[1]


def test_the_median_predicted_error_of_a_row_is_in_its_tables() -> None:
    """Runs of 0.2, 0.3 and 0.7 deg say so; one that was refused promises nothing, nor does the second row."""
    sizes = (0.2, 0.3, 0.7, 9.0)
    predicted = [{"predicted_rotation_deg": size, "predicted_translation_m": size / 10} for size in sizes]
    runs = [run_of("a", f"f{i}", 0, 1.0, 0.1, figures=values) for i, values in enumerate(predicted)]
    runs[3] = run_of("a", "f3", 0, 1.0, 0.1, figures=predicted[3], status="no-edges")
    summary = summary_of([*runs, *frames(3, "b", [1.0])])
    assert [dict(row.predicted) for row in summary.groups[0].measured] == [
        {"rotation_deg": 0.3, "translation_m": pytest.approx(0.03)},
        {},
    ]
    text = markdown(summary)
    assert [cells(text, label)["predicted 67 %"] for label in "ab"] == ["0.300 deg 3.0 cm", "-"]


# ---- the whole report


@pytest.fixture
def blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write empty figures, in tests of other parts of a report: drawing takes most of its time."""
    monkeypatch.setattr("p2o.page.figure.drawn", lambda figure: None)
    monkeypatch.setattr("p2o.page.figure.figure_files", lambda figure: {"png": b"", "svg": b"", "pdf": b""})


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
    assert names == {"report.html", "report.md", "report.tex"} | {
        f"{f}.{e}" for f in figures for e in ("png", "svg", "pdf")
    }
    text = (folder / "report.md").read_text()
    assert set(re.findall(r"\]\(([^)]*)\)", text)) == {f"{f}.png" for f in figures}
    for figure in figures:
        ElementTree.parse(folder / f"{figure}.svg")
    assert not any(pictures_in(folder.parent)), "there are no data"


def test_the_same_store_gives_the_same_bytes_in_any_process(reported: tuple[Path, ...], tmp_path: Path) -> None:
    store = reported[0].parents[1]
    command = [sys.executable, "-m", "p2o", "report", str(store), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    for path in reported:
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), path.name


@pytest.mark.usefixtures("blank_figures")
def test_only_the_studies_that_are_named_are_reported_and_the_command_names_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_store(tmp_path, table2(3, 1))
    other = HEAD.replace("T", "The other") + DATA
    write_store(tmp_path, [run_of("a", "f", 0, 1.0, 0.1)], study="other", toml=other, published=())
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "one"), "--study", "other"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == str(tmp_path / "one" / "report.html")
    assert all(Path(line).is_file() for line in lines)
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
    assert html.count("data:image/jpeg") == len(uris) == 3, "equal ones are there once"
    assert shown[1][0]["left"].partition(",")[0] == "data:image/jpeg;base64"
    before, after = (
        cv2.imdecode(np.frombuffer(base64.b64decode(shown[1][0][end].partition(",")[2]), np.uint8), 1)
        for end in ("left", "right")
    )
    assert before.shape == after.shape
    assert (np.abs(before.astype(int) - after) > 40).any(), "0.3 m aside moves the sweep"


@pytest.mark.usefixtures("blank_figures")
def test_joint_runs_show_each_of_their_frames(tmp_path: Path) -> None:
    names = ("drive/0000", "drive/0001")
    first = staged()[0]
    case = replace(first.case, frames=tuple(replace(first.case.frames[0], name=name) for name in names), joint=2)
    one = replace(first, case=case)
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
    assert frames == [("drive/0002", 0, 4), ("drive/0001", 2, 4)]
    titles = [said for said in told if said not in frames]
    assert [(done, total) for _, done, total in titles] == [(0, 3), (1, 3), (2, 3)]
    assert told == [*frames, *titles]


# ---- what can be wrong


def test_a_study_without_runs_is_named(tmp_path: Path) -> None:
    write_store(tmp_path, [], missing=[PlanRow("ours", "", "kitti", ("key",))])
    with pytest.raises(InputError, match=r"study 'table2' has no finished run yet.*p2o ablate table2"):
        write_report(tmp_path)
    assert not (tmp_path / "report").exists()


def test_a_folder_that_cannot_be_written_is_told_before_any_work(tmp_path: Path) -> None:
    write_store(tmp_path, table2(1, 1))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write the report"):
        write_report(tmp_path, tmp_path / "file" / "out")


MISSING = "2 of 3 frames of dataset 'fake' are missing from the data; expected drive/0002, ...; got 1 frames"


@pytest.mark.parametrize(
    ("values", "words", "message"),
    [
        (None, [], "the folder has no rows of a study"),
        ({}, ["--study", "tabel2"], "unknown study 'tabel2'; expected one of: table2; did you mean table2?"),
        ({}, ["--data", "fake:?frames=1"], MISSING),
        ({"contents": {}}, ["--data", "fake:?frames=3"], "this frame differs from that of the study"),
        ({}, ["--data", "fak=fake:"], "expected one of: fake"),
        ({"dataset": "two"}, ["--data", "fake:"], "NAME=DATASET:PATH with a NAME of fake, two"),
    ],
)
def test_a_store_or_data_that_do_not_fit_are_one_line_before_any_page(
    values: dict[str, Any] | None,
    words: list[str],
    message: str,
    tmp_path: Path,
    refused: Callable[..., str],
) -> None:
    if values is not None:
        others = [] if "dataset" not in values else [run_of("other", "f", 0, 1.0, 0.1, dataset="two")]
        write_store(tmp_path / "store", [*staged(**({} if others else values)), *others])
    line = refused(["report", str(tmp_path / "store"), "--plugin", PLUGIN, *words])
    assert message in line
    assert not (tmp_path / "store" / "report" / "report.html").exists()
    assert (tmp_path / "store").exists() == (values is not None)


@pytest.mark.usefixtures("blank_figures")
def test_a_page_has_the_worst_runs_of_each_row_and_plots_of_all_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page of 100,000 runs would have 136 MB."""
    from p2o_study.report import figures, page

    monkeypatch.setattr(page, "_RUN_BYTES", 40_000)
    monkeypatch.setattr(figures, "_MOST_POINTS", 10)
    runs = table2(12, 3)
    data = description(write_report(write_store(tmp_path, runs))[0])
    shown = table(data, "runs")
    assert 3 < len(shown["rows"]) < 108
    assert shown["counted"] == " runs, the worst of each row; all 108 runs are in table2.jsonl"
    assert len(json.dumps(shown["opens"])) < 200_000
    boxes, by_frame = (blocks(data, "plot")[number]["panels"][0] for number in (0, 2))
    worst = table(data, "worst")
    for row, label in enumerate(column(table(data, "rows"), "row")[:3]):
        [box] = [one for one in boxes["series"] if one["name"] == label]
        assert np.isclose(box["x"][0][2], np.median([run.error_of("roll_deg") for run in runs if run.row == label]))
        errors = [run.error_of("rotation_deg") for run in runs if run.row == label]
        pairs = zip(column(shown, "row"), column(shown, "rotation"), strict=True)
        own = [error for name, error in pairs if name == label]
        assert np.allclose(sorted(own), sorted(errors)[-len(own) :], rtol=1e-5)
        assert column(shown, "rotation")[worst["opens"][row]["row"]] == max(own)
    assert len(by_frame["y"]["names"]) == 3, "ten points of three rows"
