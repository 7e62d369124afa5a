"""Reports of studies: tables, figures and a page, computed from the single runs in a store (docs/studies.md)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import expanded
from p2o.files.whole_file import make_writable, write_errors, write_whole
from p2o.host.registry import Registry

from p2o_study.rows import Rows

if TYPE_CHECKING:
    from p2o.page.plot import Figure

    from p2o_study.summary import Summary

Tell = Callable[[str, int, int], None]
"""Callback with the name of the current image or figure, the number of finished ones and their total."""


def _silent(what: str, done: int, total: int) -> None:
    """Report nothing."""


def write_report(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    studies: Sequence[str] = (),
    data: Sequence[str] = (),
    overlays: int = 12,
    columns: Sequence[str] = (),
    registry: Registry | None = None,
    on_progress: Tell = _silent,
) -> list[Path]:
    """Write the report of the studies in a folder and return its files: report.html, report.md, report.tex, figures.

    `out` is the folder to write to (default: `report` in the folder), `studies` selects studies by name (default: all),
    `data` gives the paths of their frames as DATASET:PATH or NAME=DATASET:PATH. With data, overlays of at most
    `overlays` frames of each row are drawn, the worst first. With `columns` report.md and report.tex have tables of
    errors only, with these columns (`p2o_study.tables.ENTRIES`). The same store gives the same bytes.

    Raises InputError if there is no store or no finished run, or `out` cannot be written; UnknownNameError for an
    unknown study or dataset; and as `p2o_study.report.overlays.draw_all`.
    """
    from p2o_study import tables
    from p2o_study.report import figures, page
    from p2o_study.report.overlays import OverlayImages, draw_all

    folder = expanded(folder)
    images = OverlayImages()
    home = folder / "report" if out is None else expanded(out)
    summaries = _summaries(Rows.existing(folder), studies)
    with write_errors("the report", home, "choose another --out"):
        make_writable(home)
    if data:
        images = draw_all(summaries, data, overlays, registry or Registry.load(), on_progress)
    html = page.page(summaries, images).encode()
    named = zip(summaries, figures.figure_names(summaries), strict=True)
    drawings = {summary.name: list(figures.figures_of(summary, names)) for summary, names in named}
    titles = {study: [(title, f"{name}.png") for name, title, _ in own] for study, own in drawings.items()}
    text = tables.report_markdown(summaries, lambda summary: titles[summary.name], columns)
    latex = tables.report_latex(summaries, columns)
    drawn = write_figures(home, [drawing for own in drawings.values() for drawing in own], on_progress)
    files = {"report.html": html, "report.tex": latex.encode(), "report.md": text.encode()}
    for name, content in files.items():
        write_whole(home / name, content)
    return [*(home / name for name in files), *reversed(drawn)]


def write_figures(folder: Path, named: Sequence[tuple[str, str, Figure]], tell: Tell = _silent) -> list[Path]:
    """Write figures with (name, title, figure) as PNG, SVG and PDF to a folder, and return the files.

    Raises InputError if they cannot be written.
    """
    from p2o.page.figure import drawn, figure_files

    with write_errors("the figures", folder, "choose another folder"):
        make_writable(folder)
    paths = []
    for done, (name, title, figure) in enumerate(named):
        tell(title, done, len(named))
        for form, content in figure_files(drawn(figure)).items():
            paths.append(folder / f"{name}.{form}")
            write_whole(paths[-1], content)
    return paths


def _summaries(rows: Rows, names: Sequence[str]) -> list[Summary]:
    """Return the summaries of studies with runs; raises InputError if a study selected by name has none."""
    from p2o_study.summary import summary_of_stored

    for name in names:
        if name not in rows.studies:
            raise UnknownNameError("study", name, rows.studies, where=rows.folder)
    parts = {name: summary_of_stored(rows, rows.study(name)) for name in dict.fromkeys(names or rows.studies)}
    finished = [summary for summary in parts.values() if summary is not None]
    if not finished or (names and len(finished) < len(parts)):
        empty = next((name for name, summary in parts.items() if summary is None), "STUDY")
        what = f"study '{empty}' has no finished run yet"
        raise InputError(what, where=rows.folder, hint=f"run: p2o ablate {empty} --out {quote(str(rows.folder))}")
    return finished
