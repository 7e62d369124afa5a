"""The page of the benchmark in a real browser, headless: filters, top groups, plots, and runs on demand."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from p2o_study.benchmark import page as pages
from p2o_study.benchmark.suite import find_suite
from p2o_study.rows import Rows
from p2o_study.worker import Plugins

from tests.in_browser import Page
from tests.p2o_study.benchmark_pages import HOSTILE, PLUGIN, rows_of, spread, written

OURS = {"extractor": "canny/rings", "matcher": "nearest", "solver": "lm", "init": "given"}
INFORMATION = {"extractor": "grey/returns", "matcher": "nid", "solver": "nelder-mead", "init": "given"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results with two data sets, two initial errors, joint calibrations and three families."""
    rows = [
        *rows_of("edges", spread(0.3, 0.2), words=OURS),
        *rows_of("edges, 2 frames", spread(0.2, 0.1), joint=2, words=OURS),
        *rows_of("edges, far", spread(0.5, 0.2), start=4.0, words=OURS),
        *rows_of("information", spread(0.4, 0.2), words=INFORMATION),
        *rows_of("information @ second", spread(1.4, 0.2), dataset="second", words=INFORMATION),
        *rows_of(HOSTILE, spread(1.5, 0.1), external=True, source=HOSTILE),
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
    return page.texts("#rows tbody tr:not(.group) td:first-child")


def cells(page: Page, label: str) -> list[str]:
    lines = "[...document.querySelectorAll('#rows tbody tr:not(.group)')]"
    script = f"return {lines}.map((line) => [...line.children].map((cell) => cell.textContent))"
    [line] = [line for line in page.run(script) if line[0].startswith(label)]
    return list(line)


def test_the_page_opens_with_the_families_and_a_method_leads_to_its_rows(page: Page) -> None:
    page.until_equal(lambda: page.texts("#families tr.group"), ["edges", "external", "information"])
    assert page.find("#families").location["y"] < page.find("#rows").location["y"]
    page.click("#families tbody tr:nth-last-child(1) td")
    page.until_equal(lambda: rows(page), ["informationinformation", "information @ secondinformation"])


def test_filters_leave_the_rows_that_fit(page: Page) -> None:
    page.until_equal(lambda: page.text("#rows-count"), "6 of 6 rows")
    for choices, expected in (
        ({"family": "information", "data-set": "second"}, ["information @ secondinformation"]),
        ({"frames": "2"}, ["edges, 2 framesedges"]),
        ({"initial-error": "4deg 0.05m"}, ["edges, faredges"]),
    ):
        for name, value in choices.items():
            page.choose(f"#rows-{name}", value)
        page.until_equal(lambda: rows(page), expected)
        page.click("#rows-all")
        page.choose("#rows-suite", "tiny")
        page.until_equal(lambda: page.text("#rows-count"), "6 of 6 rows")
    page.write("#rows-find", "nid second", value="nid second")
    page.until_equal(lambda: rows(page), ["information @ secondinformation"])


def test_overlapping_intervals_share_a_top_group_within_rows_that_are_comparable(page: Page) -> None:
    page.until_equal(lambda: len(rows(page)), 6)
    assert page.count("#rows tr.group") == 4
    assert cells(page, "edgesedges")[1] == "1"
    assert cells(page, "informationinformation")[1] == "1"
    assert cells(page, "</script>")[1] == "2"
    assert cells(page, "information @ second")[1] == "1", "alone on its data set"


def test_runs_are_loaded_when_a_row_is_opened(page: Page) -> None:
    assert page.requests() == []
    page.write("#rows-find", "edges 1 2deg", value="edges 1 2deg")
    page.click("#rows tbody tr.live td")
    page.until_equal(lambda: page.text("#runs-count"), "30 of 30 runs, those with the largest errors first")
    assert page.column("runs", "rotation [deg]")[0] == "0.500"
    assert page.column("runs", "frame")[0] == "drive/005"
    assert set(page.column("runs", "verdict")) == {"trusted"}
    assert set(page.column("runs", "translation 67 % [cm]")) == {"unobservable"}
    [url] = page.requests()
    assert url.endswith(".js")


def test_plots_show_the_chosen_rows_and_open_them(page: Page) -> None:
    points = "return [...document.querySelectorAll('.plot')].map((e) => e.querySelectorAll('.point').length)"
    page.until_equal(lambda: page.run(points), [6, 6, 6, 6])
    page.until_equal(lambda: page.count(".plot polyline[points*=' ']"), 2)
    page.choose("#rows-family", "information")
    page.until_equal(lambda: page.run(points), [2, 2, 2, 2])
    page.run("document.querySelector('.plot .live').dispatchEvent(new MouseEvent('click'))")
    page.until(lambda: page.text("#detail-title").startswith("information: first, 1 frame, from 2deg"))


def test_the_card_of_a_data_set_is_shown(browser: Any, folder: Path, tmp_path: Path) -> None:
    registry = Plugins(files=(str(PLUGIN),)).registry()
    suite = find_suite("tiny", registry, folder.parent / "suites")
    card = {"Streets": {"sensor": "HDL-64E", "licence": HOSTILE, "known faults": ""}}
    results = Rows(folder.parent / "results")
    pages.write_page([suite], results, tmp_path, registry, cards=lambda table: card if table.name == "first" else {})
    page = Page(browser, tmp_path / "index.html")
    page.click("#main > section details summary")
    page.until_equal(lambda: page.texts("#main details td"), ["sensor", "HDL-64E", "licence", HOSTILE])
    page.until(lambda: "first (HDL-64E)" in page.texts("#rows-data-set option"))
