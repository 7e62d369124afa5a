"""The page of the benchmark in a real browser, headless: filters, top groups, plots, and runs on demand."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from p2o_study.benchmark import page as pages
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.suite import find_suite
from p2o_study.worker import Plugins

from tests.in_browser import Page, window
from tests.p2o_study.benchmark_pages import HOSTILE, PLUGIN, rows_of, spread, written

OURS = {"words": {"extractor": "canny/rings", "matcher": "nearest", "solver": "lm", "init": "given"}}
INFORMATION = {"words": {"extractor": "grey/returns", "matcher": "nid", "solver": "nelder-mead", "init": "given"}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results with two data sets, two initial errors, joint calibrations and three families."""
    rows = [
        *rows_of("edges", spread(0.3, 0.2), method=OURS),
        *rows_of("edges, 2 frames", spread(0.2, 0.1), joint=2, method=OURS),
        *rows_of("edges, far", spread(0.5, 0.2), start=4.0, method=OURS),
        *rows_of("information", spread(0.4, 0.2), method=INFORMATION),
        *rows_of("information @ second", spread(1.4, 0.2), dataset="second", method=INFORMATION),
        *rows_of(HOSTILE, spread(1.5, 0.1), method={"external": True, "source": HOSTILE}),
    ]
    return written(tmp_path_factory.mktemp("board"), rows).parent


@pytest.fixture
def page(browser: Any, folder: Path) -> Iterator[Page]:
    """The page, freshly loaded; at the end the browser reported nothing, and only files of the page were requested."""
    page = Page(browser, folder / "index.html")
    yield page
    assert page.complaints() == []
    own = (folder / "data").as_uri()
    assert [url for url in page.requests() if not url.startswith(own)] == []


def rows(page: Page) -> list[str]:
    return page.texts("#tables tbody td:first-child")


def cells(page: Page, label: str) -> list[str]:
    lines = "[...document.querySelectorAll('#tables tbody tr')]"
    script = f"return {lines}.map((line) => [...line.children].map((cell) => cell.textContent))"
    [line] = [line for line in page.run(script) if line[0].startswith(label)]
    return list(line)


def test_filters_leave_the_rows_that_fit(page: Page) -> None:
    page.until_equal(lambda: page.text("#count"), "6 of 6 rows")
    page.choose("#family", "information")
    page.until_equal(lambda: page.text("#count"), "2 of 6 rows")
    page.choose("#dataset", "second")
    page.until_equal(lambda: rows(page), ["information @ secondinformation"])
    page.click("#reset")
    page.until_equal(lambda: page.text("#count"), "6 of 6 rows")
    page.choose("#frames", "2")
    page.until_equal(lambda: rows(page), ["edges, 2 framesedges"])
    page.click("#reset")
    page.choose("#protocol", "4deg 0.05m")
    page.until_equal(lambda: rows(page), ["edges, faredges"])
    page.click("#reset")
    page.choose("#needs", "nothing beyond image and sweep")
    page.until_equal(lambda: page.text("#count"), "6 of 6 rows")
    page.write("#find", "nid second", value="nid second")
    page.until_equal(lambda: rows(page), ["information @ secondinformation"])


def test_overlapping_intervals_share_a_top_group_within_rows_that_are_comparable(page: Page) -> None:
    page.until_equal(lambda: len(rows(page)), 6)
    assert cells(page, "edgesedges")[1] == "1"
    assert cells(page, "informationinformation")[1] == "1"
    assert cells(page, "</script>")[1] == "2"
    assert cells(page, "information @ second")[1] == "1", "alone on its data set"


def test_runs_are_loaded_when_a_row_is_opened(page: Page) -> None:
    assert page.requests() == []
    page.click("#tables tbody tr:nth-child(2) td")
    page.until_equal(lambda: page.text("#runs-count"), "30 of 30, those with the largest errors first")
    assert page.column("runs", "rotation [deg]")[0] == "0.500"
    assert page.column("runs", "frames")[0] == "drive/005"
    assert set(page.column("runs", "verdict")) == {"trusted"}
    assert set(page.column("runs", "predicted 67 % [deg, cm]")) == {"0.400unobservable"}
    [url] = page.requests()
    assert url.endswith("/data/tiny-1-0.js")


def test_further_runs_are_loaded_one_file_at_a_time(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "_AT_ONCE", 12)
    page = Page(browser, written(tmp_path, rows_of("quick", spread(0.3, 0.2))))
    page.click("#tables tbody tr td")
    for count in (12, 24, 30):
        page.until(lambda count=count: page.text("#runs-count").startswith(f"{count} of 30"))  # type: ignore[misc]
        if count < 30:
            page.click("#more-runs")
    page.until(lambda: not page.find("#more-runs").is_displayed())
    assert len(page.requests()) == 3


def test_a_name_that_looks_like_code_is_shown_as_text(page: Page) -> None:
    page.write("#find", "stolen", value="stolen")
    page.until_equal(lambda: rows(page), [f"{HOSTILE}external"])
    page.click("#tables tbody tr td")
    page.until_equal(lambda: page.text("#detail-title"), HOSTILE)
    page.until(lambda: page.text("#runs-count").startswith("30 of 30"))
    assert HOSTILE in page.text("#detail-body")
    assert page.run("return window.stolen") is None
    assert page.count("#detail b, #tables b") == 0


def test_plots_show_the_chosen_rows_and_open_them(page: Page) -> None:
    page.until_equal(lambda: page.count("#over-seconds .point"), 6)
    page.until_equal(lambda: page.count("#over-frames polyline"), 1)
    page.until_equal(lambda: page.count("#over-start polyline"), 1)
    page.until_equal(lambda: page.count("#over-dataset .point"), 6)
    page.choose("#family", "information")
    page.until_equal(lambda: page.count("#over-seconds .point"), 2)
    page.run("document.querySelector('#over-seconds .point').dispatchEvent(new MouseEvent('click'))")
    page.until_equal(lambda: page.text("#detail-title"), "information")


def test_a_phone_scrolls_tables_inside_their_boxes(page: Page) -> None:
    with window(page.driver, 390, 844):
        width = "return document.documentElement.scrollWidth"
        page.until(lambda: page.run(width) <= 390)
        page.until(lambda: page.run("return document.querySelector('#tables .scroll').scrollWidth") > 390)
        page.click("#tables tbody tr td")
        page.until(lambda: page.text("#runs-count").startswith("30 of 30"))
        page.until(lambda: page.run(width) <= 390)
        page.until(lambda: page.run("return document.getElementById('detail').scrollWidth") <= 390)


def test_nothing_outside_of_the_folder_can_be_loaded(browser: Any, folder: Path) -> None:
    page = Page(browser, folder / "index.html")
    page.run("document.head.append(Object.assign(document.createElement('script'), {src: 'http://127.0.0.1:9/x.js'}))")
    page.until(lambda: any("Content Security Policy" in text for text in page.complaints()))


def test_the_card_of_a_data_set_is_shown(browser: Any, folder: Path, tmp_path: Path) -> None:
    registry = Plugins(files=(str(PLUGIN),)).registry()
    suite = find_suite("tiny", registry, folder.parent / "suites")
    card = {"Streets": {"sensor": "HDL-64E", "licence": HOSTILE, "known faults": ""}}
    results = Results(folder.parent / "results")
    done = pages.write_page(
        [suite], results, tmp_path, registry, cards=lambda table: card if table.name == "first" else {}
    )
    page = Page(browser, done.path)
    page.until_equal(lambda: page.texts("#cards h3"), ["Streets"])
    page.until_equal(lambda: page.texts("#cards dt"), ["sensor", "licence"])
    page.until_equal(lambda: page.texts("#cards dd"), ["HDL-64E", HOSTILE])
    page.until(lambda: "first (HDL-64E)" in page.texts("#dataset option"))
    page.choose("#dataset", "second")
    page.until(lambda: not page.find("#cards-section").is_displayed())
