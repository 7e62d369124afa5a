"""The page of a check of an extrinsic: outcome and limits by axis, or the level of a watched drive by frame."""

from __future__ import annotations

from collections.abc import Iterator

from p2o.page import page
from p2o.page.page import Block, Column, brief
from p2o.page.plot import Axis, Panel, Series, plot
from p2o.results.check import Check, CheckStatus, Watch

PAGE, JSON = "check.html", "check.json"
_LOOKS = {CheckStatus.HOLDS: "good", CheckStatus.OFF: "bad", CheckStatus.CANNOT_TELL: "warn"}
_WORDS = {status: status.replace("-", " ") for status in CheckStatus}
_LOOK_OF = {_WORDS[status]: look for status, look in _LOOKS.items()}
_FACTORS = {"deg": 1.0, "m": 100.0}
"""Factors to the printed units, degrees and centimetres."""


def _printed(value: float | None, unit: str) -> float | None:
    return None if value is None else brief(_FACTORS[unit] * value)


def _size(name: str, field: str) -> Column:
    """Return the column of a field in its printed unit."""
    return Column(name, digits=2, of=lambda one: _printed(getattr(one, field), one.unit))


_AXIS = Column("axis", text=True, hide=0, of=lambda one: one.axis)
_UNIT = Column("unit", text=True, hide=0, of=lambda one: "deg" if one.unit == "deg" else "cm")
AXIS_COLUMNS = (
    _AXIS,
    Column("outcome", text=True, hide=0, looks=_LOOK_OF, of=lambda one: _WORDS[one.holding]),
    _size("error", "off"),
    _size("standard deviation", "sigma"),
    _size("detectable error", "limit"),
    _UNIT,
)
SLIP_COLUMNS = (
    _AXIS,
    _size("change", "size"),
    _size("standard deviation", "sigma"),
    _UNIT,
    Column("detected at", text=True, of=lambda one: f"{one.noticed}: {one.noticed_frame}"),
    Column("began at", text=True, hide=2, of=lambda one: f"{one.began}: {one.began_frame}"),
)


def check_page(check: Check | Watch, text: str) -> str:
    """Return the page of a check; `text` are its lines as a terminal shows them."""
    blocks: list[Block] = [
        {"kind": "text", "text": check.reason, "mark": {"text": _WORDS[check.holding], "look": _LOOKS[check.holding]}},
        *(_of_check(check) if isinstance(check, Check) else _of_watch(check)),
    ]
    if check.warnings:
        blocks.append(page.section("Warnings", page.items(check.warnings)))
    versions = ", ".join(f"{name} {version}" for name, version in check.versions.items())
    blocks += [page.section("As text", page.code(text)), page.text(versions, "quiet")]
    return page.page("Check of an extrinsic", blocks)


def _of_check(check: Check) -> Iterator[Block]:
    table = page.table(AXIS_COLUMNS, check.axes, name="axes")
    shares = (
        f"{100 * check.power:g} % of errors of this size are detected, with {100 * check.alarm_rate:g} % false alarms."
    )
    note = page.text(f"{shares} Camera axes: x right, y down, z forward.", "quiet")
    yield page.section("By axis", table, note)
    panels = []
    for unit, name in (("deg", "rotation [deg]"), ("m", "translation [cm]")):
        axes = [axis for axis in check.axes if axis.unit == unit and axis.off is not None and axis.sigma is not None]
        if axes:
            fields = ("off", "sigma", "limit")
            off, sigma, limit = ([_printed(getattr(axis, one), unit) or 0.0 for axis in axes] for one in fields)
            ends = [[size + sign * 1.96 * width for size, width in zip(off, sigma, strict=True)] for sign in (-1, 1)]
            at = range(len(axes))
            error = Series("error with its 95 % interval", off, at, low=ends[0], high=ends[1], along="x")
            bounds = [Series("detectable error", [sign * x for x in limit], at, size=0.6) for sign in (-1, 1)]
            names = [axis.axis for axis in axes]
            panels.append(Panel(Axis(name, zero=True), Axis(names=names), [error, *bounds], marks=(0.0,)))
    yield from [plot(panels)] if panels else []
    yield page.section(f"{len(check.frames)} frames", page.fold("names", page.items(check.frames)))


def _of_watch(watch: Watch) -> Iterator[Block]:
    if watch.slips:
        yield page.section("Slips", page.table(SLIP_COLUMNS, watch.slips, name="slips"))
    levels = [frame.level for frame in watch.frames]
    names = [f"{frame.name}, {frame.axis}" for frame in watch.frames]
    series = Series("level of the highest chart", range(len(levels)), levels, "line", text=names, size=0.4)
    marks = [float(slip.began) for slip in watch.slips]
    panel = Panel(Axis("frame"), Axis("level (1: alarm)", zero=True), [series], marks=marks)
    yield page.section("Level by frame", plot([panel]), page.text("The dashed lines are the onsets of slips.", "quiet"))
    columns = (_AXIS, _size("detectable slip", "size"), _UNIT)
    yield page.section("Detectable slips", page.table(columns, watch.detectable, name="detectable"))
