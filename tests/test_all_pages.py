"""Every HTML page in a real browser, headless, on a desktop and on a phone: layout, tables, plots, texts, policy."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from p2o.cli import main
from p2o.page import page as html
from p2o.page.page import Column, cell
from p2o.page.plot import Axis, Panel, Series, plot
from p2o_fleet.fleet_state import fleet_state
from p2o_fleet.page import write_page
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, simulated_fleet, write_fleet
from p2o_fleet.store import Store
from p2o_study.report import write_report
from selenium import webdriver
from selenium.webdriver.common.keys import Keys

from tests.fake_study import PLUGIN, run_of, staged, table2, write_store
from tests.in_browser import Page, window
from tests.p2o_study.benchmark_pages import HOSTILE, rows_of, spread, written

STAGE = Path(__file__).with_name("stage_plugin.py")
SYNTHETIC = "synthetic:?right=false&scenes=1&frames_per_scene=1&width_px=320&height_px=120"
WIDTHS = (1280, 390)
CUT = """
const wide = [...document.querySelectorAll('.scroll')].filter((box) => box.scrollWidth > box.clientWidth + 1);
return [document.documentElement.scrollWidth > innerWidth, ...wide.map((box) => box.textContent.slice(0, 60))];
"""
NAMES = ("run", "shown", "check", "study", "drawn", "compared", "benchmark", "fleet", "sample")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One page of each kind; names are hostile where a user chooses them."""
    root = tmp_path_factory.mktemp("pages")
    names = ["--set", f"data.names={json.dumps([HOSTILE, 'a' * 90])}"]
    spy = ["--plugin", str(STAGE), "--data", "fake:", "--calibrator", "spy", "--perturb", "2deg 0.1m"]
    assert main(["run", *spy, *names, "--out", str(root / "run")]) == 0
    assert main(["data", "show", "fake:", "--plugin", str(STAGE), *names, "--out", str(root / "show")]) == 0
    assert main(["check", SYNTHETIC, "--extrinsic", "truth", "--out", str(root / "check")]) in (0, 1)
    write_store(root / "study", table2(12, 3), published=())
    others = [run_of(name, "f0", 0, turn, 0.1) for name, turn in ((HOSTILE, 1.0), ("far", 30))]
    study = write_report(write_store(root / "study", others, study="zoo", published=()))[0]
    write_store(root / "drawn", staged())
    assert main(["report", str(root / "drawn"), "--plugin", PLUGIN, "--data", "fake:?frames=3"]) == 0
    benchmark = written(
        root / "benchmark",
        [
            *rows_of("quick", spread(0.3, 0.2)),
            *rows_of("quick, 2 frames", spread(0.2, 0.1), joint=2),
            *rows_of(HOSTILE, spread(1.5, 0.1), external=True, source=HOSTILE),
        ],
    )
    store = Store(root / "store")
    write_fleet(simulated_fleet(Scenario(60, 24, shares={Fault.SLIP: 0.2}), NoiseBank.shipped()), store)
    (root / "sample.html").write_text(sample(), encoding="utf-8")
    return {
        "run": root / "run/result.html",
        "shown": root / "show/index.html",
        "check": root / "check/check.html",
        "study": study,
        "drawn": root / "drawn/report/report.html",
        "compared": compared(root),
        "benchmark": benchmark,
        "fleet": write_page(fleet_state(store), root / "fleet"),
        "sample": root / "sample.html",
    }


def compared(root: Path) -> Path:
    """Return the page of a comparison of hostile names."""
    from p2o_study.compare import Comparison
    from p2o_study.comparison import Standing
    from p2o_study.report.comparison_page import comparison_page
    from p2o_study.statistics import Interval, Statistics

    figures = {f"repeatability_{unit}": Interval(0.5, 0.4, 0.6) for unit in ("deg", "m")} | {"edges": Interval(2.0)}
    names = [HOSTILE, *(f"method {number}" for number in range(12))]
    ranking = [Standing(name, "edges", 1, 0.0, 0.0, figures) for name in names]
    outcomes = {name: Statistics(()) for name in names}
    distances = [(names[0], other, 0.5, 0.02) for other in names[1:]]
    shares = {"edges": dict.fromkeys(names, True)}
    its = Comparison("It <b>is</b> so.", ["\x1b[31m"], 9, 3, "1deg", ranking, [], outcomes, shares, distances)
    (root / "compare.html").write_text(comparison_page(its), encoding="utf-8")
    return root / "compare.html"


def sample() -> str:
    """Return a page with a table of 300 rows, all kinds of series, and more columns than a phone has space for."""
    columns = [
        Column("name", text=True, hide=0),
        Column("error", "deg", 2),
        Column("state", text=True, order=["bad", "good"], looks={"good": "good", "bad": "bad"}),
        *(Column(f"figure {number}", hide=2 + number) for number in range(12)),
        Column("secret", off=True),
        Column("extra", option="more"),
    ]
    rows = [
        [
            f"row {n}",
            html.interval([n / 100, 0.0, 4.0]) if n else None,
            "good" if n % 3 else "bad",
            *[1000 * n] * 12,
            f"s{n}",
            n,
        ]
        for n in range(300)
    ]
    rows[1][0] = cell("=1+1", HOSTILE)
    opens = [html.detail(f"row {n}", html.text(f"detail of {n}")) for n in range(300)]
    table = html.table(columns, rows, name="rows", search=True, filters=["state"], tiles="state", opens=opens)
    series = [
        Series("line", [1, 2, 3], [1.0, None, 3.0], "line", low=[0.5, None, 2], high=[2, None, 4]),
        Series("points", [1, 2], [0.0, 100.0]),
    ]
    boxes = Series("box", [[1.0, 2.0, 3.0, 4.0, 5.0]], [0], "box")
    bars = [Series(name, [1, 2], [3.0, 4.0], "bars") for name in ("low", "high")]
    panels = [
        Panel(Axis("x"), Axis("y", log=True), series),
        Panel(Axis("x", log=True), Axis(names=["a" * 90]), [boxes]),
        Panel(Axis("x"), Axis("y", zero=True), bars),
        Panel(Axis("x", time=True, low=0, high=1e6), Axis("y"), [Series("none", [], [])]),
    ]
    return html.page("Sample", [table, html.section("Plots", plot(panels))])


@pytest.fixture
def page(browser: Any, pages: dict[str, Path]) -> Iterator[Page]:
    """The sample, freshly loaded; at the end nothing was complained of and nothing was requested."""
    page = Page(browser, pages["sample"])
    yield page
    assert page.complaints() == []
    assert page.requests() == []


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_cut_requested_or_run_that_is_not_of_the_page(
    name: str, width: int, browser: Any, pages: dict[str, Path]
) -> None:
    with window(browser, width, 844):
        page = Page(browser, pages[name])
        page.until(lambda: page.run("return [...document.images].every((image) => image.naturalWidth > 0)"))
        page.until_equal(lambda: page.run(CUT), [False])
        if page.count("tr.live") and not page.count("main a, section.ruled"):
            page.click("tr.live td")
            page.until(lambda: page.run("return document.querySelector('dialog').open || scrollY > 0"))
            page.until_equal(lambda: page.run(CUT), [False])
        assert page.run("return [typeof stolen, typeof window.stolen]") == ["undefined", "undefined"]
        assert page.count("main b:not(.tile b), main i, dialog b") == 0, "names are no markup"
        assert page.complaints() == []
        own = (pages[name].parent / "data").as_uri()
        assert [url for url in page.requests() if not url.startswith(own)] == []


@pytest.mark.parametrize("name", ["sample", "benchmark"])
def test_the_policy_refuses_what_is_not_of_the_page(name: str, browser: Any, pages: dict[str, Path]) -> None:
    for tag in ("img", "script"):
        page = Page(browser, pages[name])
        page.run(
            f"document.body.append(Object.assign(document.createElement('{tag}'), {{src: 'http://127.0.0.1:9/x'}}))"
        )
        page.until(lambda page=page: any("Content Security Policy" in text for text in page.complaints()))  # type: ignore[misc]


def test_a_click_on_a_column_sorts_and_another_reverses_and_rows_without_a_value_are_last(page: Page) -> None:
    page.until_equal(lambda: page.text("#rows-count"), "300 of 300")
    for first in ("0.01", "2.99"):
        page.sort("rows", "error [deg]")
        page.until(lambda first=first: page.column("rows", "error [deg]")[0].startswith(first))  # type: ignore[misc]
    page.sort("rows", "name")
    page.until_equal(lambda: page.column("rows", "name")[1:4], ["row 0", "row 2", "row 3"])


def test_words_filters_and_tiles_select_rows(page: Page) -> None:
    page.write("#rows-find", "s29", value="s29")
    page.until_equal(lambda: page.text("#rows-count"), "11 of 300")
    page.click('.tile[data-value="bad"]')
    page.until_equal(lambda: page.text("#rows-count"), "3 of 300")
    assert set(page.column("rows", "state")) == {"bad"}
    page.write("#rows-find", Keys.CONTROL, "a", Keys.NULL, Keys.DELETE, value="")
    page.until_equal(lambda: page.text("#rows-count"), "100 of 300")


def test_columns_that_do_not_fit_are_hidden_least_important_first_and_rows_open_with_them(page: Page) -> None:
    with window(page.driver, 390, 844):
        page.until(lambda: "figure 11" not in page.texts("#rows thead th"))
        heads = page.texts("#rows thead th")
        assert heads[:2] == ["name", "error [deg]"]
        page.click("#rows tbody tr:nth-child(4) td")
        page.until_equal(lambda: page.text("#detail-title"), "row 3")
        facts = page.texts("#detail-body td:first-child")
        every = ["name", "error [deg]", "state", *(f"figure {n}" for n in range(12)), "secret", "extra"]
        assert sorted([*heads, *facts]) == sorted(every)
        page.click("#next")
        page.until(lambda: "detail of 4" in page.text("#detail-body"))
        page.click("#close")
        page.click("button.columns")
        page.until(lambda: "figure 11" in page.texts("#rows thead th"))
        page.click("main label input[type=checkbox]")
        page.until(lambda: "extra" in page.texts("#rows thead th"))


def test_rows_are_saved_as_csv_without_formulas(page: Page) -> None:
    page.run("URL.createObjectURL = (blob) => { blob.text().then((text) => { window.saved = text; }); return '#'; };")
    page.click("#rows-csv")
    lines = page.until(lambda: page.run("return window.saved")).splitlines()
    assert len(lines) == 301
    assert lines[0].startswith('"name","error [deg]","error low","error high","state","figure 0"')
    assert lines[2].startswith('"\'=1+1","0.01","0","4","good"')


def test_plots_draw_all_kinds_and_hide_series(page: Page) -> None:
    page.until_equal(lambda: page.count(".plot svg"), 4)
    assert page.count(".plot .point") == 2 + 1 + 1 + 4, "zero is not on a logarithmic axis, one value is unknown"
    page.until(lambda: "no values" in page.texts(".plot text"))
    page.click(".legend button")
    page.until_equal(lambda: page.count(".plot .point"), 6)


def test_a_part_of_a_plot_is_enlarged_by_dragging(page: Page) -> None:
    ticks = "return [...document.querySelectorAll('.plot:first-child text')].map((e) => e.textContent).join()"
    before = page.until(lambda: page.run(ticks))
    box = page.find(".plot svg")
    page.run("arguments[0].scrollIntoView({block: 'center'})", box)
    actions = webdriver.ActionChains(page.driver)
    actions.move_to_element(box).click_and_hold().move_by_offset(80, 60).release().perform()
    page.until(lambda: page.run(ticks) != before)
    actions = webdriver.ActionChains(page.driver)
    actions.double_click(page.find(".plot svg")).perform()
    page.until_equal(lambda: page.run(ticks), before)


def test_light_and_dark_can_be_turned(page: Page) -> None:
    ground = "return getComputedStyle(document.body).backgroundColor"
    before = page.run(ground)
    page.click("#theme")
    page.until(lambda: page.run(ground) != before)
    page.click("#theme")
    page.until_equal(lambda: page.run(ground), before)


def test_a_link_to_a_row_opens_it(browser: Any, pages: dict[str, Path]) -> None:
    page = Page(browser, f"{pages['sample'].as_uri()}#rows=row%207")
    page.until_equal(lambda: page.text("#detail-title"), "row 7")


def test_the_slider_uncovers_the_right_image(browser: Any, pages: dict[str, Path]) -> None:
    page = Page(browser, pages["drawn"])
    over, slider = page.driver.find_elements("css selector", ".compare img")[1], page.find(".slider")
    for key, share in ((Keys.HOME, 100), (Keys.END, 0)):
        slider.send_keys(key)
        page.until_equal(lambda: over.value_of_css_property("clip-path"), f"inset(0px {share}% 0px 0px)")
    box = page.find(".compare")
    webdriver.ActionChains(browser).move_to_element_with_offset(box, -box.size["width"] // 4, 0).click().perform()
    page.until(lambda: abs(float(slider.get_property("value")) - 25) < 1)
