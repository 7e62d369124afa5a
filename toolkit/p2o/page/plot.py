"""Plots as data: panels with axes and series, drawn by the page as SVG and written as PNG or SVG files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from p2o.page.page import Block, brief

Form = Literal["points", "line", "box", "bars"]


@dataclass(frozen=True)
class Axis:
    """An axis: its title, whether it is logarithmic, a time in s since 1970, includes 0, or has whole numbers only.

    With `names` it has a place for each of them, from 0; `low` and `high` limit a linear axis.
    """

    title: str = ""
    log: bool = False
    time: bool = False
    zero: bool = False
    whole: bool = False
    names: Sequence[str] = ()
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Series:
    """Values x and y of one name. Boxes have five values each as x: lower whisker, quartiles and upper whisker.

    `low` and `high` are the ends of bars `along` x or y; those of a line with a `band` its lower and upper limit.
    `text` is shown for each point. `hollow` points are marked as such, `size` scales all points.
    """

    name: str
    x: Sequence[Any]
    y: Sequence[float | None]
    form: Form = "points"
    low: Sequence[float | None] = ()
    high: Sequence[float | None] = ()
    along: Literal["x", "y"] = "y"
    band: bool = False
    text: Sequence[str] = ()
    hollow: Sequence[bool] = ()
    size: float = 1.0
    colour: str | None = None


@dataclass(frozen=True)
class Panel:
    """One plot with its series; `marks` are vertical lines."""

    x: Axis
    y: Axis
    series: Sequence[Series]
    title: str = ""
    note: str = ""
    marks: Sequence[float] = ()
    height: int | None = None


def plot(panels: Sequence[Panel], *, least: int = 420) -> Block:
    """Return the block of panels side by side, each at least `least` px wide, with one legend."""
    return {"kind": "plot", "panels": [_plain(panel) for panel in panels], "least": least}


def plot_of_table(table: str, panels: Sequence[dict[str, Any]]) -> Block:
    """Return the block of plots of the rows of a table that its filters show; the table is before it on the page."""
    return {"kind": "plot", "table": table, "panels": panels}


def table_panel(title: str, x: str, y: str, name: str, titles: tuple[str, str], **words: Any) -> dict[str, Any]:
    """Return a plot of the columns `x` and `y` of a table, with intervals if they have any, on logarithmic axes.

    `name` is the column of the names of series, `titles` those of the axes. Further words: `join`, the columns that
    rows whose points are joined have in common; `categories`, True for an x of names; `diagonal`, True for a line of
    equal values; `note`.
    """
    is_log = not words.pop("categories", False)
    x_axis = {"column": x, "title": titles[0], "log": is_log, "categories": not is_log}
    return {"title": title, "name": name, "x": x_axis, "y": {"column": y, "title": titles[1], "log": True}, **words}


def _plain(panel: Panel) -> Mapping[str, Any]:
    """Return a panel as plain data without its defaults, numbers with 6 digits."""
    return {
        **_given(Panel(Axis(), Axis(), ()), panel, ("x", "y", "series")),
        "x": _given(Axis(), panel.x),
        "y": _given(Axis(), panel.y),
        "series": [
            {"name": one.name, "x": _numbers(one.x), "y": _numbers(one.y), **_given(Series("", (), ()), one, _FIXED)}
            for one in panel.series
        ],
    }


_FIXED = ("name", "x", "y")


def _given(default: Any, value: Any, left_out: Sequence[str] = ()) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from those of its default."""
    plain = {}
    for name, own in vars(value).items():
        is_empty = isinstance(own, list | tuple) and not own
        if name not in left_out and own is not None and not is_empty and own != getattr(default, name):
            plain[name] = _numbers(own) if isinstance(own, list | tuple) else own
    return plain


def _numbers(values: Sequence[Any]) -> list[Any]:
    return [
        _numbers(one) if isinstance(one, list | tuple) else one if isinstance(one, str | bool) else brief(one)
        for one in values
    ]


@dataclass(frozen=True)
class Figure:
    """Panels with a title, `columns` side by side, as written to a file."""

    title: str
    panels: Sequence[Panel]
    columns: int = 1
    size: tuple[float, float] = (7.0, 4.6)
