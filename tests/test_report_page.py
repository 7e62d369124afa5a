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
from p2o.report import write_report
from p2o.study.columns import METRICS
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

from tests.in_browser import Page


@pytest.fixture(scope="module")
def table2_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a study of four rows in two groups, beside that of another study."""
    folder = write_store(tmp_path_factory.mktemp("table2"), table2(12, 3))
    hostile = "</script><script>window.stolen = 1</script> <b>$x$</b> {{data}}"
    nothing: Any = {**dict.fromkeys(METRICS), "estimate": None, "rounds": ()}
    others = [run_of(name, "f0", 0, 1.0, 0.1, study="zoo") for name in (hostile, "raised")]
    others[1] = replace(others[1], status="stage-failed", exception="Traceback: no such luck", **nothing)
    others.append(run_of("far off", "f0", 0, 30.0, 0.1, study="zoo"))
    write_store(folder, others, toml='title = "A zoo of <i>names</i>"', published=())
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
    assert page.find("h1").text == "Table 2: KITTI & <others>"
    assert page.texts("#rows tbody td:first-child") == [
        "ours w/o OGM",
        "ours w/o UB",
        "ours",
        "ourspublished: P2O-Calib, Table 2",
        "RGGNetpublished: Yuan et al. 2020",
    ]
    assert page.find("#count").text == "108 of 108 runs"
    assert len(page.texts("#runs tbody tr")) == 108
    assert len(page.driver.find_elements(By.CSS_SELECTOR, "#boxes .boxlayer .trace")) == 3
    assert len(page.driver.find_elements(By.CSS_SELECTOR, "#frames .scatterlayer .trace")) == 3
    assert len(page.driver.find_elements(By.CSS_SELECTOR, "#rounds .scatterlayer .trace")) == 6


def test_published_figures_are_marked_and_not_bold(page: Page) -> None:
    assert len(page.driver.find_elements(By.CSS_SELECTOR, "#rows tr.published")) == 2
    assert page.texts("#rows tr.published td.best") == []
    assert page.texts("#rows td.best")


def test_nothing_is_wider_than_the_window(page: Page) -> None:
    assert page.run("return document.documentElement.scrollWidth <= window.innerWidth")


def test_a_phone_has_room_for_everything(page: Page) -> None:
    """Rounds stand below each other there, and names of frames are cut at their begin, which they share."""
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    layout = "document.getElementById('rounds')._fullLayout"
    axes = f"return [{layout}.xaxis.domain, {layout}.xaxis2.domain]"
    frames = "return document.getElementById('frames').layout.yaxis.ticktext[3]"
    beside, name = page.run(axes), page.run(frames)
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        WebDriverWait(page.driver, 20).until(lambda _: page.run(frames) != name)
        assert page.run("return document.documentElement.scrollWidth") <= 390
        assert page.run(frames) == "…05/0000000003"
        below = page.run(axes)
        assert beside[0][1] < beside[1][0]
        assert below[0] == below[1] == [0, 1]
    finally:
        page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_click_on_a_column_sorts_and_another_turns_it_round(page: Page) -> None:
    page.sort("runs", "rotation [deg]")
    upwards = numbers(page.column("runs", "rotation [deg]"))
    assert upwards == sorted(upwards)
    assert len(set(upwards)) > 50
    page.sort("runs", "rotation [deg]")
    assert numbers(page.column("runs", "rotation [deg]")) == upwards[::-1]
    assert page.find("#runs th[aria-sort]").get_attribute("aria-sort") == "descending"
    page.sort("runs", "frame")
    assert page.column("runs", "frame") == sorted(page.column("runs", "frame"))


def test_rows_without_a_figure_are_sorted_last_either_way(page: Page) -> None:
    for _ in ("upwards", "downwards"):
        page.sort("rows", "rotation median [deg]")
        assert page.column("rows", "rotation median [deg]")[-2:] == ["-", "-"]


def test_words_rows_and_status_filter_the_runs(page: Page) -> None:
    page.find("#find").send_keys("0000000007 converged")
    found = page.column("runs", "frame")
    assert set(found) == {"2011_09_26/drive_0005/0000000007"}
    assert page.find("#count").text == f"{len(found)} of 108 runs"
    page.find("#find").send_keys(Keys.CONTROL, "a")
    page.find("#find").send_keys(Keys.DELETE)
    Select(page.find("#row")).select_by_visible_text("ours w/o UB")
    assert page.column("runs", "row") == ["ours w/o UB"] * 36
    Select(page.find("#row")).select_by_visible_text("all")
    Select(page.find("#status")).select_by_visible_text("too-few-matches")
    assert set(page.column("runs", "status")) == {"too-few-matches"}
    page.find("#find").send_keys("no such frame")
    assert page.find("#count").text == "0 of 108 runs"


def test_verdicts_are_counted_by_row_sorted_by_trust_and_filter_the_runs(page: Page) -> None:
    words = {"trusted", "ambiguous", "doubtful", "refused"}
    for row, verdict in zip(page.texts("#rows tbody td:first-child")[:3], page.column("rows", "verdict"), strict=False):
        counts = {word: int(number) for number, word in (part.split() for part in verdict.split(", "))}
        assert sum(counts.values()) == 36, row
        assert set(counts) <= words
    assert page.column("rows", "verdict")[3:] == ["-", "-"], "published rows have none"
    page.sort("runs", "verdict")
    found = page.column("runs", "verdict")
    assert list(dict.fromkeys(found)) == ["trusted", "ambiguous", "doubtful", "refused"], "best first"
    Select(page.find("#trust")).select_by_visible_text("doubtful")
    assert page.column("runs", "verdict") == ["doubtful"] * found.count("doubtful")


def test_a_run_says_its_verdict_its_reasons_and_the_evidence(page: Page) -> None:
    Select(page.find("#trust")).select_by_visible_text("ambiguous")
    page.click("#runs tbody tr:nth-child(1) td")
    text = page.find("#detail-body").text
    assert "ambiguous: another pose, 1.61 deg and 0.20 m away, fits as well" in text
    assert "next best 1.61 deg and 0.2 m away, 1.25 edges worse" in text
    assert "two of three within 0.25 deg and 0.05 m, 19 of 20 within 0.75 deg and 0.15 m" in text
    assert "4.25 px at the start, 3.5 px at the end, by directed-distance" in text
    page.click("#close")
    Select(page.find("#trust")).select_by_visible_text("refused")
    page.click("#runs tbody tr:nth-child(1) td")
    text = page.find("#detail-body").text
    assert "refused" in text
    assert text.count("at least 30 are needed") == 1, "said once, beside the status"


def test_the_worst_run_of_each_row_is_there_at_once_with_what_went_wrong(page: Page) -> None:
    assert page.texts("#worst h3") == ["ours w/o OGMrefused", "ours w/o UBambiguous", "ourstrusted"]
    assert page.find("#no-pictures").is_displayed()
    page.sort("runs", "rotation [deg]")
    worst = page.column("runs", "rotation [deg]")[-1]
    said = page.texts("#worst p")[0]
    assert said.startswith("It was refused (too-few-matches): 12 pairs within 50 px, at least 30 are needed.")
    assert f"{float(worst):.2f} deg" in said
    page.click("#worst .card:nth-child(1) button")
    assert page.find("#detail-title").text.startswith("ours w/o OGM, ")


def test_a_study_that_knows_no_verdicts_shows_none(page: Page) -> None:
    Select(page.find("#study")).select_by_index(1)
    assert "verdict" not in page.texts("#rows thead th") + page.texts("#runs thead th")
    assert not page.find("#trust-choice").is_displayed()


def test_a_click_on_a_row_shows_its_runs(page: Page) -> None:
    page.click("#rows tbody tr:nth-child(3) td")
    assert set(page.column("runs", "row")) == {"ours"}


def test_a_run_opens_with_its_numbers_and_leads_to_the_next(page: Page) -> None:
    page.sort("runs", "rotation [deg]")
    turns = page.column("runs", "rotation [deg]")
    page.click("#runs tbody tr:nth-child(1) td")
    assert page.texts("#detail-body .facts table tr:nth-child(2) td")[:3] == ["rotation [deg]", "2.000", turns[0]]
    assert "converged" in page.find("#detail-body").text
    assert not page.find("#previous").is_enabled()
    page.click("#next")
    assert page.texts("#detail-body .facts table tr:nth-child(2) td")[2] == turns[1]
    assert page.driver.find_elements(By.CSS_SELECTOR, "#detail-body img") == [], "there are no data, so no pictures"
    page.click("#close")
    assert not page.find("#detail").is_displayed()


def test_a_click_on_a_point_opens_the_worst_run_of_its_frame(page: Page) -> None:
    page.run("document.getElementById('frames').emit('plotly_click', {points: [{customdata: 5}]})")
    assert page.find("#detail-title").text == "ours w/o OGM, 2011_09_26/drive_0005/0000000001, seed 2"


def test_groups_studies_and_metrics_can_be_chosen(page: Page) -> None:
    Select(page.find("#metric")).select_by_visible_text("yaw [deg]")
    assert page.run("return document.getElementById('boxes').layout.xaxis.title.text") == "yaw error [deg]"
    Select(page.find("#group")).select_by_visible_text("jointly solved frames")
    assert page.find("#count").text == "3 of 3 runs"
    assert not page.find("#pairs-section").is_displayed()
    page.click("#axes")
    assert {"roll mean [deg]", "roll median [deg]"} <= set(page.texts("#rows thead th"))


def test_boxes_are_logarithmic_where_rows_differ_much_and_as_the_reader_wants(page: Page) -> None:
    def shown() -> tuple[str, str]:
        axis = page.run("return document.getElementById('boxes').layout.xaxis")
        return axis.get("type", "linear"), axis["title"]["text"]

    assert shown() == ("linear", "rotation error [deg]")
    page.click("#log")
    assert shown() == ("log", "|rotation error| [deg]")
    Select(page.find("#study")).select_by_index(1)
    assert shown() == ("log", "|rotation error| [deg]"), "1 deg and 30 deg"
    Select(page.find("#metric")).select_by_visible_text("translation [cm]")
    assert shown() == ("linear", "translation error [cm]"), "both rows are 10 cm off"
    Select(page.find("#metric")).select_by_visible_text("yaw [deg]")
    traces = page.run("return document.getElementById('boxes').data.map((trace) => trace.x)")
    assert min(value for trace in traces for value in trace) > 0, "yaws are negative here, sizes are not"


def test_names_that_look_like_code_are_shown_as_they_are(page: Page) -> None:
    Select(page.find("#study")).select_by_index(1)
    assert page.find("h1").text == "A zoo of <i>names</i>"
    assert page.texts("#rows tbody td:first-child")[0].startswith("</script><script>window.stolen = 1</script> <b>")
    assert page.run("return window.stolen") is None
    page.click("#runs tbody tr:nth-child(2) td")
    assert "no such luck" in page.find("#detail-body").text


def test_light_and_dark_can_be_turned(page: Page) -> None:
    def ground() -> str:
        return str(page.run("return getComputedStyle(document.body).backgroundColor"))

    before = ground()
    page.click("#theme")
    assert ground() != before
    page.click("#theme")
    assert ground() == before


def test_nothing_can_be_asked_for_even_if_a_script_tried(browser: Any, table2_page: Path) -> None:
    """The policy in the page refuses what is not in it; the browser says so."""
    page = Page(browser, table2_page)
    page.run("document.body.append(Object.assign(new Image(), {src: 'http://127.0.0.1:9/x.png'}))")
    WebDriverWait(browser, 10).until(lambda _: any("Content Security Policy" in text for text in page.complaints()))


def test_a_page_without_plotly_has_all_but_the_plots(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_store(tmp_path, table2(3, 1))
    monkeypatch.setattr("p2o.report.page.plot_library", lambda: "")
    page = Page(browser, write_report(tmp_path)[0])
    assert page.find("#no-plots").text.startswith("the page has no plots")
    assert not page.find("#plots").is_displayed()
    assert not page.find("#rounds-section").is_displayed()
    assert page.find("#count").text == "9 of 9 runs"
    page.click("#theme")
    page.click("#worst .card button")
    assert page.find("#detail").is_displayed()
    assert page.complaints() == []
    assert page.requests() == []


def test_the_slider_uncovers_the_picture_after_the_calibration(browser: Any, tmp_path: Path) -> None:
    write_store(tmp_path, staged())
    assert main(["report", str(tmp_path), "--plugin", PLUGIN, "--data", "fake:?frames=3"]) == 0
    page = Page(browser, tmp_path / "report" / "report.html")
    shown = page.driver.find_elements(By.CSS_SELECTOR, "#worst .compare img")
    assert [p.get_attribute("alt").partition(", ")[2] for p in shown] == ["drive/0002"] * 4, (
        "two rows, before and after"
    )
    WebDriverWait(browser, 10).until(lambda _: all(p.get_property("naturalWidth") > 100 for p in shown))
    assert not page.find("#no-pictures").is_displayed()
    page.click("#runs tbody tr:nth-child(1) td")
    pictures = page.driver.find_elements(By.CSS_SELECTOR, "#detail .compare img")
    assert [p.get_attribute("alt") for p in pictures] == [
        "edges at the estimate, drive/0000",
        "edges at the start, drive/0000",
    ]
    WebDriverWait(browser, 10).until(lambda _: all(p.get_property("naturalWidth") > 100 for p in pictures))
    over, slider = pictures[1], page.find("#detail .slider")
    assert over.value_of_css_property("clip-path") == "inset(0px 50% 0px 0px)"
    slider.send_keys(Keys.HOME)
    assert over.value_of_css_property("clip-path") == "inset(0px 100% 0px 0px)"
    slider.send_keys(Keys.END)
    assert over.value_of_css_property("clip-path") == "inset(0px 0% 0px 0px)"
    # A press on the picture, a quarter of its width from the left.
    box = page.find("#detail .compare")
    width = box.size["width"]
    webdriver.ActionChains(browser).move_to_element_with_offset(box, -width // 4, 0).click().perform()
    assert np.isclose(float(slider.get_property("value")), 25, atol=1)
    assert page.complaints() == []
    assert page.requests() == []
