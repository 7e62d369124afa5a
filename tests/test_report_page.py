"""The page of a report in a real browser: rows, the worst runs, choices, and what runs open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from p2o_study.report import write_report

from tests.fake_study import TOML, run_of, table2, write_store
from tests.in_browser import Page

ZOO = "A zoo of <i>names</i>"


@pytest.fixture(scope="module")
def table2_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a study of four rows in two groups, beside that of another study."""
    folder = write_store(tmp_path_factory.mktemp("table2"), table2(12, 3))
    raised: Any = {"status": "stage-failed", "exception": "Traceback: no such luck", "rounds": ()}
    others = [run_of("near", "f0", 0, 1.0, 0.1), run_of("raised", "f0", 0, 1.0, 0.1, **raised)]
    others.append(run_of("far off", "f0", 0, 30.0, 0.1))
    write_store(folder, others, study="zoo", toml=TOML.replace("Table 2: KITTI & <others>", ZOO), published=())
    return write_report(folder)[0]


@pytest.fixture
def page(browser: Any, table2_page: Path) -> Iterator[Page]:
    """The page with its second study, freshly loaded; at the end nothing was complained of."""
    page = Page(browser, table2_page)
    page.choose("#choose-study", "Table 2: KITTI & <others>")
    page.until_equal(lambda: page.text("#runs-count"), "108 of 108 runs")
    yield page
    assert page.complaints() == []
    assert page.requests() == []


def opened(page: Page) -> str:
    """Return the text of the first run of the table, opened, once it is there."""
    page.click("#runs tbody tr td")
    return page.until(lambda: page.text("#detail-body"))


def test_the_page_shows_rows_runs_and_plots(page: Page) -> None:
    rows = ["ours w/o OGM", "ours w/o UB", "ours", "ours", "RGGNet"]
    published = [*[""] * 3, "published: P2O-Calib, Table 2", "published: Yuan et al. 2020"]
    texts = [name + source for name, source in zip(rows, published, strict=True)]
    page.until_equal(lambda: page.texts("#rows tbody td:first-child"), texts)
    page.until_equal(lambda: page.count(".plot svg"), 10)
    page.until_equal(lambda: page.count("#rows tr.published"), 2)
    assert page.count("#rows td.strong")
    assert page.count("#rows tr.published td.strong") == 0, "published figures are never bold"
    for _ in ("upwards", "downwards"):
        page.sort("rows", "rotation median [deg]")
        page.until_equal(lambda: page.column("rows", "rotation median [deg]")[-2:], ["-", "-"])


def test_words_rows_verdicts_and_status_filter_the_runs(page: Page) -> None:
    page.write("#runs-find", "0000000007 converged", value="0000000007 converged")
    page.until_equal(lambda: set(page.column("runs", "frame")), {"2011_09_26/drive_0005/0000000007"})
    page.click("#runs-all")
    page.choose("#runs-row", "ours w/o UB")
    page.until_equal(lambda: page.column("runs", "row"), ["ours w/o UB"] * 36)
    page.choose("#runs-row", "all")
    page.choose("#runs-status", "too-few-matches")
    page.until_equal(lambda: set(page.column("runs", "verdict")), {"refused"})
    page.choose("#runs-status", "all")
    page.sort("runs", "verdict")
    order = list(dict.fromkeys(page.column("runs", "verdict")))
    assert order == ["trusted", "ambiguous", "doubtful", "refused"], "best first"


def test_verdicts_are_counted_by_row(page: Page) -> None:
    verdicts = page.column("rows", "verdict")
    for verdict in verdicts[:3]:
        counts = {word: int(number) for number, word in (part.split() for part in verdict.split(", "))}
        assert sum(counts.values()) == 36
    assert verdicts[3:] == ["-", "-"], "published rows have none"


def test_a_run_says_its_verdict_its_reasons_and_the_evidence(page: Page) -> None:
    page.choose("#runs-verdict", "ambiguous")
    text = opened(page)
    assert "ambiguous" in text
    for said in (
        "another pose, 1.61 deg and 0.20 m away, fits as well",
        "pose at a distance of 1.61 deg, 0.20 m, cost higher by 1.2 edges",
        "rotation error 0.25 deg (67 %), 0.75 deg (95 %), translation error 0.050 m (67 %), 0.150 m (95 %)",
        "4.25 px at the initial guess, 3.5 px at the result, by directed-distance",
    ):
        assert said in text
    page.click("#close")
    page.choose("#runs-verdict", "refused")
    assert opened(page).count("at least 30 are needed") == 1, "said once, beside the status"


def test_the_worst_run_of_each_row_is_there_at_once_with_what_went_wrong(page: Page) -> None:
    page.until_equal(lambda: page.column("worst", "row"), ["ours w/o OGM", "ours w/o UB", "ours"])
    assert page.column("worst", "verdict") == ["doubtful", "ambiguous", "trusted"]
    page.sort("runs", "rotation [deg]")
    page.sort("runs", "rotation [deg]")
    assert page.column("worst", "rotation [deg]")[0] == page.column("runs", "rotation [deg]")[0]
    assert page.column("worst", "reasons")[0]
    page.click("#worst tbody tr td")
    page.until(lambda: page.text("#detail-title").startswith("ours w/o OGM, "))


def test_a_study_without_verdicts_shows_none_and_a_run_that_raised_its_traceback(page: Page) -> None:
    page.choose("#choose-study", ZOO)
    page.until_equal(lambda: page.column("rows", "row"), ["near", "raised", "far off"])
    assert "verdict" not in page.texts("#rows thead th") + page.texts("#runs thead th")
    page.choose("#runs-status", "stage-failed")
    assert "no such luck" in opened(page)


def test_a_click_on_a_row_shows_its_runs_and_a_run_leads_to_the_next(page: Page) -> None:
    page.click("#rows tbody tr:nth-child(3) td")
    page.until_equal(lambda: set(page.column("runs", "row")), {"ours"})
    page.sort("runs", "rotation [deg]")
    turns = page.column("runs", "rotation [deg]")
    assert list(map(float, turns)) == sorted(map(float, turns))
    first = page.column("runs", "frame")[:2]
    opened(page)
    page.until(lambda: first[0] in page.text("#detail-title"))
    assert not page.find("#previous").is_enabled()
    page.click("#next")
    page.until(lambda: first[1] in page.text("#detail-title"))
    assert page.count("#detail-body img") == 0, "there are no data, so no overlays"


def test_groups_axes_and_studies_can_be_chosen(page: Page) -> None:
    titles = "return [...document.querySelectorAll('.plot svg > text')].map(one => one.textContent)"
    page.until(lambda: "x [cm]" in page.run(titles))
    page.choose("#choose-rows", "jointly solved frames")
    page.until_equal(lambda: page.text("#runs-count"), "3 of 3 runs")
    page.until_equal(lambda: page.count("#pairs"), 0)
    page.click("main input[type=checkbox]")
    page.click("button.columns")
    page.until(lambda: {"roll mean [deg]", "roll median [deg]"} <= set(page.texts("#rows thead th")))
    page.choose("#choose-study", ZOO)
    page.until(lambda: "|roll| [deg]" in page.run(titles))  # logarithmic: 1 deg and 30 deg
