"""The studies of rivals: every method runs in them, on the same frames and from the same starts, and makes a page."""

from __future__ import annotations

from pathlib import Path

import p2o_baselines
import pytest
from p2o import Registry
from p2o.cli import main
from p2o_study.report import write_report
from p2o_study.rows import Rows
from p2o_study.study import check_study, find_study

STUDIES = ("rivals", "rivals-00", "rivals-drive")
SMALL = "synthetic:?scenes=1&width_px=248&height_px=76&place=street&right=false&lidar=vlp-16"

FEW = {
    "mask-consistency": "options.solver.samples = 30",
    "nmi": "options.solver.iterations = 10",
    **dict.fromkeys(("mi", "gom", "nid"), "options.solver.generations = 20"),
}
"""Methods that take most of the time, with options of a short search: that they run is tested here, not the result."""


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry.load()


@pytest.mark.parametrize("name", [*STUDIES, "motion", "motion-drive", "motion-long", "learned"])
def test_every_row_fits_together(name: str, registry: Registry) -> None:
    assert check_study(find_study(name, registry), registry)


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
    shipped = Path(p2o_baselines.__file__).parent / "studies/rivals.toml"
    text = shipped.read_text(encoding="utf-8")
    for method, few in FEW.items():
        text = text.replace(f'method = "{method}"\n', f'method = "{method}"\n{few}\n')
    file = tmp_path / "rivals.toml"
    file.write_text(text, encoding="utf-8")
    words = ["ablate", str(file), "--data", SMALL, "--seeds", "1", "--out", str(tmp_path), "--jobs", "1", "--quiet"]
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
