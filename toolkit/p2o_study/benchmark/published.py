"""Figures of publications that a suite lists as `[[published]]`, as tables of pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from p2o.errors import UnknownNameError

from p2o_study.benchmark.marks import Writer
from p2o_study.benchmark.suite import Suite
from p2o_study.study import Published
from p2o_study.tables import md_text

_COLUMNS = ("method", "training", "initial error", "frames", "figure", "rotation [deg]", "translation [cm]", "source")


def published_text(suite: Callable[[str], Suite]) -> Writer:
    """Return the writer of marked parts with published figures; `suite` returns a suite of a name."""

    def text(subject: str, choices: Mapping[str, str]) -> str:
        if choices:
            raise KeyError(*choices)
        name, _, section = subject.partition(", ")
        quoting = suite(name)
        lines = [_line(entry) for entry in quoting.published if section in ("", entry.section)]
        if not lines:
            raise UnknownNameError(
                "section", section, {entry.section for entry in quoting.published}, where=quoting.file
            )
        head = [_row(_COLUMNS), "|:--|:--|:--|:--|:--|--:|--:|:--|"]
        return "\n".join([*head, *lines, ""])

    return text


def _line(entry: Published) -> str:
    angle, shift = entry.values.get("rotation_deg"), entry.values.get("translation_m")
    figures = ["" if angle is None else f"{angle:g}", "" if shift is None else f"{100 * shift:.3g}"]
    source = f"{entry.source}; {entry.note}" if entry.note else entry.source
    words = (entry.label, entry.training, entry.start, entry.frames, entry.figure, *figures, source)
    return _row([md_text(word) for word in words])


def _row(cells: tuple[str, ...] | list[str]) -> str:
    return f"| {' | '.join(cells)} |"
