"""Names in a store are somebody else's: no file of a report leaves its folder, and none of them is taken for markup."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from p2o.errors import printable
from p2o_study.report import write_report
from p2o_study.report.figures import figure_names, figures_of
from p2o_study.study import parse_study
from p2o_study.summary import summarised

from tests.fake_study import TOML, run_of, write_store

STUDY = parse_study(TOML)
HOSTILE = (
    "../../X",
    "/etc/passwd",
    "",
    "C:\\x/../..\x00\x1b]0;title\x07\x1b[2J\u202eleft\u2028\u0085next",
    "\\input{/etc/passwd}%\n\\write18{id} $x^2$ & # _ ~ { } </script><script>alert(1)</script>",
    "[click](javascript:alert(1)) ![x](y) <b> =1+1|cmd " + "x" * 3000,
)


def hostile_store(folder: Path, names: Sequence[str] = HOSTILE) -> Path:
    """Write one study for each hostile name: that of its row, section, data set and frame, and of its messages."""
    for number, name in enumerate(names):
        runs = [
            run_of(name, f"{name}{frame}", 0, 1.0 + frame, 0.1, section=name, dataset=name, reason=name, why=name)
            for frame in range(2)
        ]
        title = name if name and printable(name) == name and len(name) <= 120 else "T"
        # JSON is one of TOML's texts.
        toml = TOML.replace('"Table 2: KITTI & <others>"', json.dumps(title))
        published = ({"label": title.replace('"', ""), "source": "x", "values": {"rotation_deg": 1.0}},)
        write_store(folder, runs, study=f"study-{number}", toml=toml, published=() if "\\" in title else published)
    return folder


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[Path, ...]]:
    """Return a folder with nothing but a store in it, and the files of its report, whose figures are empty."""
    folder = hostile_store(tmp_path_factory.mktemp("outer") / "inner" / "folder")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("p2o.page.figure.drawn", lambda figure: None)
        patch.setattr("p2o.page.figure.figure_files", lambda figure: {"png": b"", "svg": b"", "pdf": b""})
        return folder, tuple(write_report(folder))


def test_figures_are_drawn_whatever_rows_sections_and_data_sets_are_called(tmp_path: Path) -> None:
    runs = [
        run_of(name, f"{name}{frame}", 0, 1.0 + frame, 0.1, section=HOSTILE[4], dataset=HOSTILE[3])
        for name in HOSTILE
        for frame in range(2)
    ]
    files = write_report(write_store(tmp_path, runs))
    figures = [file for file in files if file.suffix in (".png", ".svg", ".pdf")]
    assert len(figures) == 9
    assert all(file.stat().st_size > 1000 for file in figures)


def test_every_file_of_a_report_lies_in_its_folder_whatever_studies_are_called(
    hostile: tuple[Path, tuple[Path, ...]],
) -> None:
    folder, files = hostile
    assert {file.parent for file in files} == {folder / "report"}
    present = {
        path for path in folder.parents[1].rglob("*") if path.is_file() and path.suffix not in (".json", ".jsonl")
    }
    assert present == set(files)
    assert all(re.fullmatch(r"[A-Za-z0-9._-]{1,160}", file.name) for file in files)
    # Three figures a study, each of them in three formats; that of convergence too.
    assert len(files) == 3 + 9 * len(HOSTILE)


def test_no_name_is_a_control_character_a_script_or_a_link(hostile: tuple[Path, tuple[Path, ...]]) -> None:
    texts = {f.suffix: f.read_text(encoding="utf-8") for f in hostile[1] if f.suffix not in (".png", ".pdf")}
    for suffix, text in texts.items():
        assert [c for c in text if not c.isprintable() and c != "\n"] == [], suffix
    assert "<script>alert" not in texts[".html"]
    for target in re.findall(r"(?<!\\)\]\((.*?)\)", texts[".md"]):
        assert re.fullmatch(r"[A-Za-z0-9._-]+\.png", target)
    assert "](javascript" not in texts[".md"]


def test_no_name_is_a_command_of_latex(hostile: tuple[Path, tuple[Path, ...]]) -> None:
    [tex] = [file for file in hostile[1] if file.suffix == ".tex"]
    lines = tex.read_text(encoding="utf-8").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("%"))
    known = "begin end centering caption resizebox linewidth toprule midrule bottomrule textbf textit"
    known += " textbackslash textasciitilde textasciicircum textless textgreater textbar"
    assert set(re.findall(r"\\([A-Za-z]+)", text)) <= set(known.split())
    assert not re.search(r"(?<!\\)[$#_~^]", text)
    depth = 0
    for mark in re.findall(r"(?<!\\)[{}]", text):
        depth += 1 if mark == "{" else -1
        assert depth >= 0
    assert depth == 0


def test_figures_of_two_studies_never_share_a_file() -> None:
    """The second group of "a" would be called like the study "a-2", and "A" like "a" where case does not count."""
    sections = [run_of("x", "f", 0, 1.0, 0.1), run_of("y", "f", 0, 1.0, 0.1, section="other")]
    names = ("a", "a-2", "A", "a_b", "a b", "ж", "ц")
    summaries = [replace(summarised(STUDY, sections if name == "a" else sections[:1]), name=name) for name in names]
    found = [name for names in figure_names(summaries) for name in names]
    assert len({name.lower() for name in found}) == len(found) == 8
    assert figure_names(summaries[:1]) == [("a-1", "a-2")]


@pytest.mark.system
def test_a_study_of_very_many_rows_has_figures_of_the_first() -> None:
    """A picture may be 65535 px high, which boxes of some 800 rows would not fit into."""
    runs = [run_of(f"row {i}", "f", 0, 1.0, 0.1) for i in range(250)]
    drawn = {name: (title, figure) for name, title, figure in figures_of(summarised(STUDY, runs))}
    title, figure = drawn["table2-boxplot"]
    assert "(the first 200 rows of 250)" in title
    assert figure.size[1] * 130 < 2**15
