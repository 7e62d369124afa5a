"""Write plots as PNG, SVG and PDF files by matplotlib, without its global state."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from p2o.errors import printable
from p2o.files.whole_file import write_whole
from p2o.page.page import COLOURS
from p2o.page.plot import Axis, Figure, Panel, Series

_MARKERS = "os^DvPX*"
_DASHES = ("-", "--", ":", "-.")
_LONGEST_NAME = 40
_LETTERS_PER_INCH = 15
"""Of a legend."""


def drawn(figure: Figure) -> Any:
    """Return the figure of matplotlib: panels with their series, and one legend below them."""
    rows = -(-len(figure.panels) // figure.columns)
    out, axes = figure_with_panels(figure.size, rows, figure.columns, squeeze=False)
    panels = axes.ravel()
    names = list(dict.fromkeys(one.name for panel in figure.panels for one in panel.series))
    for axis, panel in zip(panels, figure.panels, strict=False):
        _draw(axis, panel, names)
    for place, axis in enumerate(panels):
        axis.set_visible(place < len(figure.panels) and _is_shown(figure.panels[place]))
        # Panels side by side share the names of their rows.
        if place % figure.columns and place < len(figure.panels) and figure.panels[place].y.names:
            axis.set_yticklabels([])
    if figure.title:
        out.suptitle(_plain(figure.title), fontsize=11)
    if not any(one.form == "box" for panel in figure.panels for one in panel.series):
        _legend(out, panels[: len(figure.panels)])
    return out


def figure_files(figure: Any) -> dict[str, bytes]:
    """Return a figure as "png", "svg" and "pdf", in one layout; the same figure gives the same bytes."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    png, svg, pdf = io.BytesIO(), io.BytesIO(), io.BytesIO()
    figure.dpi = 130
    # Not `savefig`, which draws everything twice, with a layout each time.
    FigureCanvasAgg(figure).print_png(png, metadata={"Software": None})
    figure.set_layout_engine("none")
    with matplotlib.rc_context({"svg.hashsalt": "p2o"}):
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Date": None, "Creator": None})
    # TrueType: publishers refuse fonts of type 3.
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        FigureCanvasPdf(figure).print_pdf(pdf, metadata={"CreationDate": None, "Creator": None, "Producer": None})
    return {"png": png.getvalue(), "svg": svg.getvalue(), "pdf": pdf.getvalue()}


def figure_with_panels(size: tuple[float, float], rows: int, columns: int = 1, **layout: Any) -> tuple[Any, Any]:
    """Return a figure of a size in inches and its panels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **layout)


def save_figure(figure: Any, path: Path | str) -> None:
    """Write a figure as PNG; raises InputError if the file cannot be written."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # Characters that the font lacks are drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    write_whole(path, buffer.getvalue())


def _draw(axis: Any, panel: Panel, names: Sequence[str]) -> None:
    # Bars are stacked.
    floor: dict[float, float] = {}
    for series in panel.series:
        look = _look(series, names.index(series.name))
        x, y = _array(series.x), _array(series.y)
        low, high = _array(series.low), _array(series.high)
        if series.form == "box":
            _draw_boxes(axis, series, look["color"])
        elif series.form == "bars":
            base = [floor.get(at, 0.0) for at in x]
            axis.bar(x, y, 0.7, base, color=look["color"], label=_short(series.name))
            floor |= {at: below + size for at, below, size in zip(x, base, y, strict=True)}
        else:
            if series.band:
                axis.fill_between(x, low, high, color=look["color"], alpha=0.15, lw=0)
            elif len(low):
                ends = axis.hlines if series.along == "x" else axis.vlines
                ends(y if series.along == "x" else x, low, high, color=look["color"], lw=1.1, alpha=0.6)
            style = look if series.form == "line" else {**look, "linestyle": "none"}
            axis.plot(x, y, ms=4 * series.size, lw=1.4, label=_short(series.name), **style)
            hollow = [n for n, one in enumerate(series.hollow) if one]
            axis.plot(x[hollow], y[hollow], ls="none", marker=look["marker"], mfc="w", mec=look["color"], ms=4)
    if not panel.series:
        axis.text(0.5, 0.5, "no values", ha="center", va="center", transform=axis.transAxes, color="0.5")
    for mark in panel.marks:
        axis.axvline(mark, color="0.6", lw=0.8, zorder=0)
    _scale(axis, "x", panel.x)
    _scale(axis, "y", panel.y)
    if panel.title:
        axis.set_title(_plain(panel.title), fontsize=9)
    axis.grid(axis="x" if panel.y.names else "both", alpha=0.3, lw=0.6)
    axis.spines[["top", "right"]].set_visible(False)


def _draw_boxes(axis: Any, series: Series, colour: str) -> None:
    keys = ("whislo", "q1", "med", "q3", "whishi")
    boxes = [dict(zip(keys, values, strict=True)) for values in series.x]
    drawn = axis.bxp(
        boxes,
        positions=series.y,
        orientation="horizontal",
        widths=0.6,
        patch_artist=True,
        manage_ticks=False,
        showfliers=False,
        medianprops={"color": "black", "lw": 1.4},
    )
    for box in drawn["boxes"]:
        box.set(facecolor=colour, alpha=0.75, lw=0.8)


def _scale(axis: Any, name: str, scale: Axis) -> None:
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    own = axis.xaxis if name == "x" else axis.yaxis
    axis.set(**{f"{name}label": _plain(scale.title) if scale.title else ""})
    if scale.names:
        own.set_ticks(range(len(scale.names)), [_short(one) for one in scale.names], fontsize=7)
        axis.set(**{f"{name}lim": (len(scale.names) - 0.4, -0.6) if name == "y" else (-0.6, len(scale.names) - 0.4)})
    elif scale.log:
        axis.set(**{f"{name}scale": "log"})
        own.set_major_locator(LogLocator(subs=(1, 3)))
        own.set_major_formatter("{x:g}")
        own.set_minor_formatter(NullFormatter())
    elif scale.low is not None or scale.high is not None:
        axis.set(**{f"{name}lim": (scale.low, scale.high)})
    elif scale.zero:
        low, high = getattr(axis, f"get_{name}lim")()
        axis.set(**{f"{name}lim": (min(0.0, low), max(0.0, high))})
    if scale.whole:
        own.set_major_locator(MaxNLocator(integer=True))


def _look(series: Series, number: int) -> dict[str, str]:
    """Return colour, line style and marker of the series with this number; 28 are distinct."""
    colour = series.colour or COLOURS[number % len(COLOURS)]
    dash = _DASHES[number // len(COLOURS) % len(_DASHES)]
    return {"color": colour, "linestyle": dash, "marker": _MARKERS[number % len(_MARKERS)]}


def _legend(figure: Any, panels: Sequence[Any]) -> None:
    """Draw the legend below the figure, in at most 3 columns."""
    known = {
        label: handle for panel in panels for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    if not known:
        return
    room = _LETTERS_PER_INCH * figure.get_figwidth() / (max(map(len, known)) + 8)
    columns = max(1, min(3, int(room), len(known)))
    figure.legend(
        known.values(),
        list(known),
        loc="outside lower center",
        ncols=columns,
        fontsize=8,
        frameon=False,
    )


def _array(values: Sequence[Any]) -> Any:
    return np.array([math.nan if one is None else one for one in values], np.float64) if not _nested(values) else None


def _nested(values: Sequence[Any]) -> bool:
    return bool(len(values)) and isinstance(values[0], list | tuple)


def _is_shown(panel: Panel) -> bool:
    return bool(panel.series or panel.x.title or panel.y.title)


def _short(name: str) -> str:
    """Return a name without its middle: rows differ at their beginning, frames at their end."""
    half = _LONGEST_NAME // 2
    return _plain(name if len(name) <= _LONGEST_NAME else f"{name[: half - 2]}...{name[2 - half :]}")


def _plain(text: str) -> str:
    """Escape a text for matplotlib: $ begins a formula, a leading _ or an empty label hides a legend entry."""
    text = printable(text)
    return (" " + text if text.startswith("_") or not text else text).replace("$", r"\$")
