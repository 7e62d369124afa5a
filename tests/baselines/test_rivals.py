"""The studies of rivals: every method runs in them, on the same frames and from the same starts, and makes a page."""

from __future__ import annotations

from pathlib import Path

import pytest
from p2o import Registry
from p2o.cli import main
from p2o.run.presets import presets
from p2o_study.report import write_report
from p2o_study.rows import Rows
from p2o_study.study import check_study, find_study

STUDIES = ("rivals", "rivals-00", "rivals-drive")
SMALL = "synthetic:?scenes=1&width_px=310&height_px=94&place=street&right=false&lidar=hdl-32e"


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry.load()


@pytest.mark.parametrize("name", [*STUDIES, "motion", "motion-drive", "motion-long", "learned"])
def test_every_row_fits_together(name: str, registry: Registry) -> None:
    assert check_study(find_study(name, registry), registry)


@pytest.mark.parametrize("name", [*STUDIES, "families"])
def test_rows_have_the_label_of_their_method_which_names_what_is_missing(name: str, registry: Registry) -> None:
    by_matcher = {preset.words["matcher"]: preset.label for preset in presets(registry).values() if preset.label}
    by_matcher.pop("ogm", None)  # the label of the method `paper`, of which these studies have no row
    assert "without SAM" in by_matcher["mask-consistency"]
    rows = [row for row in check_study(find_study(name, registry), registry) if not row.words.get("calibrator")]
    labels = {row.label: by_matcher[row.words["matcher"]] for row in rows if row.words["matcher"] in by_matcher}
    assert len(labels) > 3
    assert [label for label, begin in labels.items() if not label.startswith(begin)] == []


def test_every_matcher_of_the_baselines_is_among_them(registry: Registry) -> None:
    rows = check_study(find_study("rivals", registry), registry)
    ours = {"ogm"}
    assert {row.words["matcher"] for row in rows} - ours == {
        "crlf", "gmm", "gom", "idt", "knn-line", "line-idt", "lines", "mask-consistency", "mi", "nearest", "nid", "nmi",
        "tv-fusion",
    }  # fmt: skip


def test_all_of_them_run_on_a_synthetic_frame_and_make_a_page(
    tmp_path: Path, registry: Registry, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["ablate", "rivals", "--data", SMALL, "--seeds", "1", "--out", str(tmp_path), "--jobs", "1", "--quiet"]
    assert main(words) == 0, "none of them raised"
    told = capsys.readouterr().out
    assert "within" in told
    study = find_study("rivals", registry)
    rows = Rows(tmp_path).planned("rivals")
    assert {row.row for row in rows} == {row.label for row in study.rows()}
    assert all(row.seconds for row in rows)
    page, *_ = (path for path in write_report(tmp_path, registry=registry) if path.suffix == ".html")
    text = page.read_text()
    for label in [row.label for row in study.rows()] + [published.label for published in study.published]:
        assert label in text
