"""Reports of studies: tables, figures and one page, all made from the single runs in a store (docs/reports.md)."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from p2o.errors import InputError, UnknownNameError, printable
from p2o.files.input_file import expanded
from p2o.files.whole_file import write_whole

if TYPE_CHECKING:
    from p2o.host.registry import Registry
    from p2o.report.summary import Summary

Tell = Callable[[str, int, int], None]
"""Is told what is drawn, how many pictures or figures are done, and of how many."""
_LONGEST_NAME = 100
"""So much of the name of a study is shown in errors; a foreign store may call it what it likes."""


def write_report(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    studies: Sequence[str] = (),
    data: Sequence[str] = (),
    overlays: int = 12,
    registry: Registry | None = None,
    on_progress: Tell | None = None,
    on_warning: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write the report of the studies in a folder and return its files: report.html, report.md, report.tex, figures.

    `out` is the folder to write to (default: `report` in the folder), `studies` the names of those to report (default:
    all), `data` where their frames are, as DATASET:PATH or NAME=DATASET:PATH. With data, at most `overlays` frames of
    each row are drawn, the worst first. The same store gives the same bytes. `on_progress` is told what is drawn,
    `on_warning` what is missing: without plotly the page has no plots.

    Raises InputError where there is no store, no finished run, or `out` cannot be written; UnknownNameError for an
    unknown study or dataset; and as `p2o.report.overlays.draw_all`.
    """
    from p2o.report import figures, page, tables
    from p2o.report.overlays import Pictures, draw_all

    folder = expanded(folder)
    summaries = _summaries(folder, studies)
    home = _prepared(folder / "report" if out is None else expanded(out))
    tell = on_progress or (lambda what, done, total: None)
    pictures = Pictures()
    if data:
        if registry is None:
            from p2o.host.registry import Registry as Loaded

            registry = Loaded.load()
        pictures = draw_all(summaries, data, overlays, registry, tell)
    files: dict[str, bytes] = {}
    drawn: dict[str, list[tuple[str, str]]] = {}
    # Groups without rounds or errors have fewer figures than this.
    done, total = 0, figures.KINDS * sum(len(summary.groups) for summary in summaries)
    for summary, names in zip(summaries, figures.figure_names(summaries), strict=True):
        for name, title, figure in figures.figures_of(summary, names):
            tell(title, done, total)
            done += 1
            drawn.setdefault(summary.name, []).append((title, f"{name}.png"))
            for form in ("png", "svg"):
                files[f"{name}.{form}"] = figures.rendered(figure, form)
    files["report.md"] = tables.markdown(summaries, lambda summary: drawn.get(summary.name, ())).encode()
    files["report.tex"] = tables.latex(summaries).encode()
    library = page.plot_library()
    if not library and on_warning is not None:
        on_warning(page.NO_PLOTS)
    files["report.html"] = page.page(summaries, pictures, library).encode()
    for name, content in files.items():
        write_whole(home / name, content)
    return [home / name for name in reversed(files)]


def _summaries(folder: Path, names: Sequence[str]) -> list[Summary]:
    """Return the summaries of the studies, those without a single run left out unless asked for by name."""
    # Imported here: the page of a run shares this room, and needs no studies.
    from p2o.report.summary import summarise_study
    from p2o.study.store import Store

    with Store.open(folder, create=False) as store:
        known = {study.name: study for study in store.studies()}
        for name in names:
            if name not in known:
                raise UnknownNameError("study", name, known, where=store.path)
        wanted = [known[name] for name in dict.fromkeys(names or known)]
        parts = [(study, store.rows(study.name), store.missing(study.name)) for study in wanted]
    finished = [summarise_study(study, runs, missing) for study, runs, missing in parts if runs]
    if not finished or (names and len(finished) < len(wanted)):
        empty = next((study.name for study, runs, _ in parts if not runs), None)
        what, word = "there is no study in the store", "STUDY"
        if empty:
            what = f"study '{printable(empty, _LONGEST_NAME)}' has no finished run yet"
            word = quote(empty) if len(empty) <= _LONGEST_NAME else word
        raise InputError(what, where=store.path, hint=f"run: p2o ablate {word} --out {quote(str(folder))}")
    return finished


def _prepared(home: Path) -> Path:
    """Return the folder, made if need be; InputError at once where it cannot be written."""
    try:
        home.mkdir(parents=True, exist_ok=True)
        probe = home / f".p2o-{os.getpid()}"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as problem:
        raise InputError(
            "cannot write the report", where=home, got=problem.strerror or str(problem), hint="choose another --out"
        ) from problem
    return home
