"""The page of a report in a real browser, headless: it renders, reacts, asks for nothing and complains of nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.fake_study import PLUGIN, run_of, staged, table2, write_store

pytest.importorskip("plotly", reason="the extra `report` is not installed")
pytest.importorskip("selenium", reason="selenium is not installed")

from p2o.cli import main
from p2o_study.columns import METRICS
from p2o_study.report import write_report
from selenium import webdriver
from selenium.webdriver.common.keys import Keys

from tests.in_browser import Page, window

ZOO = "A zoo of <i>names</i>"


@pytest.fixture(scope="module")
def table2_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a study of four rows in two groups, beside that of another study."""
    folder = write_store(tmp_path_factory.mktemp("table2"), table2(12, 3))
    hostile = "</script><script>window.stolen = 1</script> <b>$x$</b> {{data}}"
    nothing: Any = {**dict.fromkeys(METRICS), "estimate": None, "rounds": ()}
    others = [run_of(name, "f0", 0, 1.0, 0.1, study="zoo") for name in (hostile, "raised")]
    others[1] = replace(others[1], status="stage-failed", exception="Traceback: no such luck", **nothing)
    others.append(run_of("far off", "f0", 0, 30.0, 0.1, study="zoo"))
    write_store(folder, others, toml=f'title = "{ZOO}"', published=())
    return write_report(folder)[0]


@pytest.fixture
def page(browser: Any, table2_page: Path) -> Iterator[Page]:
    """The page, freshly loaded; at the end nothing was complained of and nothing was asked for."""
    page = Page(browser, table2_page)
    yield page
    assert page.complaints() == []
    assert page.requests() == []


def numbers(texts: list[str]) -> list[float]:
    return [float(text) for text in texts]


def test_the_page_shows_rows_runs_and_plots(page: Page) -> None:
    page.until_equal(lambda: page.text("h1"), "Table 2: KITTI & <others>")
    rows = [
        "ours w/o OGM",
        "ours w/o UB",
        "ours",
        "ourspublished: P2O-Calib, Table 2",
        "RGGNetpublished: Yuan et al. 2020",
    ]
    page.until_equal(lambda: page.texts("#rows tbody td:first-child"), rows)
    page.until_equal(lambda: page.text("#count"), "108 of 108 runs")
    page.until_equal(lambda: page.count("#runs tbody tr"), 108)
    page.until_equal(lambda: page.count("#boxes .boxlayer .trace"), 3)
    page.until_equal(lambda: page.count("#frames .scatterlayer .trace"), 3)
    page.until_equal(lambda: page.count("#rounds .scatterlayer .trace"), 6)


def test_published_figures_are_marked_and_not_bold(page: Page) -> None:
    page.until_equal(lambda: page.count("#rows tr.published"), 2)
    page.until(lambda: page.texts("#rows td.best"))
    assert page.texts("#rows tr.published td.best") == []


def test_nothing_is_wider_than_the_window(page: Page) -> None:
    page.until_equal(lambda: page.count("#boxes .boxlayer .trace"), 3)
    page.until(lambda: page.run("return document.documentElement.scrollWidth <= window.innerWidth"))


def test_a_phone_has_room_for_everything(page: Page) -> None:
    """Rounds stand below each other there, and names of frames are cut at their begin, which they share."""
    layout = "document.getElementById('rounds')._fullLayout"
    axes = f"return {layout} ? [{layout}.xaxis.domain, {layout}.xaxis2.domain] : null"
    frames = "return document.getElementById('frames').layout?.yaxis.ticktext[3]"
    beside, name = page.until(lambda: page.run(axes)), page.until(lambda: page.run(frames))
    assert name != "…05/0000000003"
    assert beside[0][1] < beside[1][0]
    with window(page.driver, 390, 844):
        page.until_equal(lambda: page.run(frames), "…05/0000000003")
        page.until_equal(lambda: page.run(axes), [[0, 1], [0, 1]])
        page.until(lambda: page.run("return document.documentElement.scrollWidth") <= 390)


def test_a_click_on_a_column_sorts_and_another_turns_it_round(page: Page) -> None:
    page.sort("runs", "rotation [deg]")
    upwards = numbers(page.column("runs", "rotation [deg]"))
    assert upwards == sorted(upwards)
    assert len(set(upwards)) > 50
    page.sort("runs", "rotation [deg]")
    page.until_equal(lambda: numbers(page.column("runs", "rotation [deg]")), upwards[::-1])
    assert page.find("#runs th[aria-sort]").get_attribute("aria-sort") == "descending"
    page.sort("runs", "frame")
    assert page.column("runs", "frame") == sorted(page.column("runs", "frame"))


def test_rows_without_a_figure_are_sorted_last_either_way(page: Page) -> None:
    for _ in ("upwards", "downwards"):
        page.sort("rows", "rotation median [deg]")
        page.until_equal(lambda: page.column("rows", "rotation median [deg]")[-2:], ["-", "-"])


def test_words_rows_and_status_filter_the_runs(page: Page) -> None:
    page.write("#find", "0000000007 converged", value="0000000007 converged")
    page.until_equal(lambda: set(page.column("runs", "frame")), {"2011_09_26/drive_0005/0000000007"})
    page.until_equal(lambda: page.text("#count"), f"{len(page.column('runs', 'frame'))} of 108 runs")
    page.write("#find", Keys.CONTROL, "a", Keys.NULL, Keys.DELETE, value="")
    page.choose("#row", "ours w/o UB")
    page.until_equal(lambda: page.column("runs", "row"), ["ours w/o UB"] * 36)
    page.choose("#row", "all")
    page.choose("#status", "too-few-matches")
    page.until_equal(lambda: set(page.column("runs", "status")), {"too-few-matches"})
    page.write("#find", "no such frame", value="no such frame")
    page.until_equal(lambda: page.text("#count"), "0 of 108 runs")


def test_verdicts_are_counted_by_row_sorted_by_trust_and_filter_the_runs(page: Page) -> None:
    words = {"trusted", "ambiguous", "doubtful", "refused"}
    verdicts = page.column("rows", "verdict")
    for row, verdict in zip(page.texts("#rows tbody td:first-child")[:3], verdicts, strict=False):
        counts = {word: int(number) for number, word in (part.split() for part in verdict.split(", "))}
        assert sum(counts.values()) == 36, row
        assert set(counts) <= words
    assert verdicts[3:] == ["-", "-"], "published rows have none"
    page.sort("runs", "verdict")
    found = page.column("runs", "verdict")
    assert list(dict.fromkeys(found)) == ["trusted", "ambiguous", "doubtful", "refused"], "best first"
    page.choose("#trust", "doubtful")
    page.until_equal(lambda: page.column("runs", "verdict"), ["doubtful"] * found.count("doubtful"))


def test_a_run_says_its_verdict_its_reasons_and_the_evidence(page: Page) -> None:
    page.choose("#trust", "ambiguous")
    page.until_equal(lambda: set(page.column("runs", "verdict")), {"ambiguous"})
    page.click("#runs tbody tr:nth-child(1) td")
    text = page.until(lambda: page.text("#detail-body"))
    assert "ambiguous: another pose, 1.61 deg and 0.20 m away, fits as well" in text
    assert "next best pose at a distance of 1.61 deg, 0.20 m, cost higher by 1.2 edges" in text
    assert "rotation error 0.25 deg (67 %), 0.75 deg (95 %), translation error 0.050 m (67 %), 0.150 m (95 %)" in text
    assert "4.25 px at the initial guess, 3.5 px at the result, by directed-distance" in text
    page.click("#close")
    page.until(lambda: not page.find("#detail").is_displayed())
    page.choose("#trust", "refused")
    page.until_equal(lambda: set(page.column("runs", "verdict")), {"refused"})
    page.click("#runs tbody tr:nth-child(1) td")
    text = page.until(lambda: page.text("#detail-body"))
    assert "refused" in text
    assert text.count("at least 30 are needed") == 1, "said once, beside the status"


def test_the_worst_run_of_each_row_is_there_at_once_with_what_went_wrong(page: Page) -> None:
    page.until_equal(lambda: page.texts("#worst h3"), ["ours w/o OGMrefused", "ours w/o UBambiguous", "ourstrusted"])
    page.until(lambda: page.find("#no-overlays").is_displayed())
    page.sort("runs", "rotation [deg]")
    worst = page.column("runs", "rotation [deg]")[-1]
    said = page.texts("#worst p")[0]
    assert said.startswith("The run was refused (too-few-matches): 12 pairs within 50 px, at least 30 are needed.")
    assert f"{float(worst):.2f} deg" in said
    page.click("#worst .card:nth-child(1) button")
    page.until(lambda: page.text("#detail-title").startswith("ours w/o OGM, "))


def test_a_study_that_knows_no_verdicts_shows_none(page: Page) -> None:
    page.choose("#study", ZOO)
    page.until_equal(lambda: page.text("h1"), ZOO)
    page.until(lambda: "verdict" not in page.texts("#rows thead th") + page.texts("#runs thead th"))
    page.until(lambda: not page.find("#trust-choice").is_displayed())
    assert page.texts("#rows thead th")
    assert page.texts("#runs thead th")


def test_a_click_on_a_row_shows_its_runs(page: Page) -> None:
    page.click("#rows tbody tr:nth-child(3) td")
    page.until_equal(lambda: set(page.column("runs", "row")), {"ours"})


def test_a_run_opens_with_its_numbers_and_leads_to_the_next(page: Page) -> None:
    page.sort("runs", "rotation [deg]")
    turns = page.column("runs", "rotation [deg]")
    page.click("#runs tbody tr:nth-child(1) td")
    turn = "#detail-body .facts table tr:nth-child(2) td"
    page.until_equal(lambda: page.texts(turn)[:3], ["rotation [deg]", "2.000", turns[0]])
    assert "converged" in page.text("#detail-body")
    assert not page.find("#previous").is_enabled()
    page.click("#next")
    page.until_equal(lambda: page.texts(turn)[2:3], [turns[1]])
    assert page.count("#detail-body img") == 0, "there are no data, so no overlays"
    page.click("#close")
    page.until(lambda: not page.find("#detail").is_displayed())


def test_a_click_on_a_point_opens_the_worst_run_of_its_frame(page: Page) -> None:
    page.run("document.getElementById('frames').emit('plotly_click', {points: [{customdata: 5}]})")
    title = "ours w/o OGM, 2011_09_26/drive_0005/0000000001, seed 2"
    page.until_equal(lambda: page.text("#detail-title"), title)


def test_groups_studies_and_metrics_can_be_chosen(page: Page) -> None:
    page.choose("#metric", "yaw [deg]")
    axis = "return document.getElementById('boxes').layout.xaxis.title.text"
    page.until_equal(lambda: page.run(axis), "yaw error [deg]")
    page.choose("#group", "jointly solved frames")
    page.until_equal(lambda: page.text("#count"), "3 of 3 runs")
    page.until(lambda: not page.find("#pairs-section").is_displayed())
    page.click("#axes")
    page.until(lambda: {"roll mean [deg]", "roll median [deg]"} <= set(page.texts("#rows thead th")))


def test_boxes_are_logarithmic_where_rows_differ_much_and_as_the_reader_wants(page: Page) -> None:
    def shown() -> tuple[str, str]:
        axis = page.run("return document.getElementById('boxes').layout.xaxis")
        return axis.get("type", "linear"), axis["title"]["text"]

    page.until_equal(shown, ("linear", "rotation error [deg]"))
    page.click("#log")
    page.until_equal(shown, ("log", "|rotation error| [deg]"))
    page.choose("#study", ZOO)
    page.until_equal(lambda: page.text("h1"), ZOO)
    page.until_equal(shown, ("log", "|rotation error| [deg]"))  # 1 deg and 30 deg
    page.choose("#metric", "translation [cm]")
    page.until_equal(shown, ("linear", "translation error [cm]"))  # both rows are 10 cm off
    page.choose("#metric", "yaw [deg]")
    page.until(lambda: "yaw" in shown()[1])
    traces = page.run("return document.getElementById('boxes').data.map((trace) => trace.x ?? trace.lowerfence)")
    assert min(value for trace in traces for value in trace) > 0, "yaws are negative here, sizes are not"


def test_names_that_look_like_code_are_shown_as_they_are(page: Page) -> None:
    page.choose("#study", ZOO)
    page.until_equal(lambda: page.text("h1"), ZOO)
    name = "</script><script>window.stolen = 1</script> <b>"
    page.until(lambda: page.texts("#rows tbody td:first-child")[0].startswith(name))
    assert page.run("return window.stolen") is None
    page.click("#runs tbody tr:nth-child(2) td")
    page.until(lambda: "no such luck" in page.text("#detail-body"))


def test_light_and_dark_can_be_turned(page: Page) -> None:
    def ground() -> str:
        return str(page.run("return getComputedStyle(document.body).backgroundColor"))

    before = ground()
    page.click("#theme")
    page.until(lambda: ground() != before)
    page.click("#theme")
    page.until_equal(ground, before)


def test_nothing_can_be_asked_for_even_if_a_script_tried(browser: Any, table2_page: Path) -> None:
    """The policy in the page refuses what is not in it; the browser says so."""
    page = Page(browser, table2_page)
    page.run("document.body.append(Object.assign(new Image(), {src: 'http://127.0.0.1:9/x.png'}))")
    page.until(lambda: any("Content Security Policy" in text for text in page.complaints()))


def test_a_page_without_plotly_has_all_but_the_plots(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_store(tmp_path, table2(3, 1))
    monkeypatch.setattr("p2o_study.report.page.plot_library", lambda: "")
    page = Page(browser, write_report(tmp_path)[0])
    page.until(lambda: page.text("#no-plots").startswith("the page has no plots"))
    page.until(lambda: not page.find("#plots").is_displayed())
    page.until(lambda: not page.find("#rounds-section").is_displayed())
    page.until_equal(lambda: page.text("#count"), "9 of 9 runs")
    page.click("#theme")
    page.click("#worst .card button")
    page.until(lambda: page.find("#detail").is_displayed())
    assert page.complaints() == []
    assert page.requests() == []


def test_the_slider_uncovers_the_picture_after_the_calibration(browser: Any, tmp_path: Path) -> None:
    write_store(tmp_path, staged())
    assert main(["report", str(tmp_path), "--plugin", PLUGIN, "--data", "fake:?frames=3"]) == 0
    page = Page(browser, tmp_path / "report" / "report.html")

    def pictures(where: str) -> list[str]:
        """Return what the pictures of a place show, once all are there."""
        all_of = f"[...document.querySelectorAll('{where} .compare img')]"
        page.until(lambda: page.run(f"const p = {all_of}; return p.length && p.every((p) => p.naturalWidth > 100)"))
        return list(page.run(f"return {all_of}.map((p) => p.alt)"))

    assert [alt.partition(", ")[2] for alt in pictures("#worst")] == ["drive/0002"] * 4, "two rows, before and after"
    page.until(lambda: not page.find("#no-overlays").is_displayed())
    page.click("#runs tbody tr:nth-child(1) td")
    assert pictures("#detail") == ["edges at the estimate, drive/0000", "edges at the start, drive/0000"]
    over, slider = page.driver.find_elements("css selector", "#detail .compare img")[1], page.find("#detail .slider")
    page.until_equal(lambda: over.value_of_css_property("clip-path"), "inset(0px 50% 0px 0px)")
    slider.send_keys(Keys.HOME)
    page.until_equal(lambda: over.value_of_css_property("clip-path"), "inset(0px 100% 0px 0px)")
    slider.send_keys(Keys.END)
    page.until_equal(lambda: over.value_of_css_property("clip-path"), "inset(0px 0% 0px 0px)")
    # A press on the picture, a quarter of its width from the left.
    box = page.find("#detail .compare")
    width = box.size["width"]
    webdriver.ActionChains(browser).move_to_element_with_offset(box, -width // 4, 0).click().perform()
    page.until(lambda: np.isclose(float(slider.get_property("value")), 25, atol=1))
    assert page.complaints() == []
    assert page.requests() == []
