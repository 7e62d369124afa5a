"""The page of `p2o pick`: image and sweep as two panels in one plane, which are clicked, and a list of the pairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from p2o.arrays import Float, UInt8
from p2o.geometry.camera import Camera
from p2o.problems.picked_pairs import PickedPairs
from p2o.results.figures import status_text

from p2o_pages.pick.range_image import LAYERS, RangeImage
from p2o_pages.pick.session import MIN_SOLVED_PAIRS, PickSession, Residuals
from p2o_pages.server import HOST, PageServer

_WIDTH = 100.0
_GAP = 3.0
"""Width of both panels and the gap between them, in units of the scene."""
_COLOURS = {"inlier": (0, 200, 0), "outlier": (255, 0, 0), "open": (0, 130, 255), "waiting": (255, 170, 0)}
_MARK_ARM, _MARK_GAP = 0.7, 0.15
_MARK_Z, _BORDER_Z = -0.006, -0.003
"""Marks in front of the panels, with a dark border behind them; the viewpoint is at negative z."""
_NEAR = 0.3
_FREE_ON_PHONE = 0.4
"""Share of the height of a window that viser's controls leave free on a phone."""
_MAX_TEXTURE_PX, _MAX_ENLARGEMENT = 4096, 4
_NO_PAIR = "none"
_HELP = """\
Click a point in one view, then the same point in the other. Drag a rectangle to zoom in; F or a click shows the
whole views again. Mouse wheel: zoom; right button: move; N, P: next and previous frame; Esc: discard the point that
waits.

Corners and poles at different distances are best: 6 to 15 pairs all over the image.
"""


@dataclass(frozen=True)
class Panel:
    """A panel of `columns` x `rows` pixels in the plane z = 0 (x right, y down) from x = 0 to _WIDTH.

    A pixel is `stretch` times as high as wide; pixel centres are at integers. `top` is the y of the upper border.
    """

    columns: int
    rows: int
    top: float = 0.0
    stretch: int = 1

    @property
    def bottom(self) -> float:
        """The y of the lower border."""
        return self.top + self.rows * self.stretch * _WIDTH / self.columns

    def position(self, pixels: Float) -> Float:
        """Return the positions (N, 2) of pixels (N, 2), column and row."""
        return (pixels + 0.5) * [1, self.stretch] * (_WIDTH / self.columns) + [0, self.top]

    def pixel(self, position: Float) -> Float | None:
        """Return the pixel (2,), column and row, at a position (2,), or None outside of the panel."""
        pixel = (position - [0, self.top]) / (_WIDTH / self.columns) / [1, self.stretch] - 0.5
        inside = (pixel >= -0.5).all() and (pixel <= [self.columns - 0.5, self.rows - 0.5]).all()
        return np.asarray(pixel) if inside else None


def arranged(camera: Camera, ranges: RangeImage) -> tuple[Panel, Panel]:
    """Return the image and, below it, the range image of the sweep."""
    image = Panel(camera.width, camera.height)
    rows, columns = ranges.index.shape
    return image, Panel(columns, rows, image.bottom + _GAP, ranges.stretch)


class PickServer(PageServer):
    """Serves the page of one session until `done` is set or it is closed; raises as PageServer.

    A click is a ray, whose intersection with the plane of the panels is exact at any zoom.
    """

    session: PickSession

    def __init__(self, session: PickSession, port: int = 0) -> None:
        super().__init__("p2o pick", session, HOST, port)
        self._labels: list[Any] = []
        self._build()
        self.show(frame=True)
        self._do(session.solve, "click a point in either view")

    def _build(self) -> None:
        """Add all controls."""
        gui, scene = self._viser.gui, self._viser.scene
        self.layer = gui.add_dropdown("sweep by", LAYERS)
        self.layer.on_update(lambda _: self._draw_sweep())
        whole = gui.add_button("whole views (F)")
        self.table = gui.add_html("")
        self.pair = gui.add_dropdown("pair", [_NO_PAIR], hint="The selected pair has a frame around its marks.")
        self.pair.on_update(lambda _: self._draw_marks())
        self.delete = gui.add_button("delete this pair", color="red")
        self.delete.on_click(lambda _: self._do(self._delete))
        self.finish = gui.add_button("done", color="green")
        self.finish.on_click(lambda _: self._finish())
        gui.add_markdown(_HELP)
        forget = gui.add_command("forget the point that waits", hotkey="escape")
        forget.on_trigger(lambda _: self._do(self.session.forget))
        for label, key, step in (("next frame", "N", 1), ("previous frame", "P", -1)):
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(lambda _, step=step: self._open_frame(self.session.number + step))
        for button in (whole.on_click, gui.add_command("whole views", hotkey="F").on_trigger):
            button(lambda event: self._show_whole(event.client))
        gui.main_panel.dock_right()
        scene.set_up_direction("-y")
        scene.on_click()(self._clicked)
        scene.on_rect_select()(self._zoom)
        self._viser.initial_camera.near = _NEAR
        self._viser.on_client_connect(self._fit_when_resized)

    # ---- the view of one client

    def _show_whole(self, client: Any) -> None:
        self._view(client, np.zeros(2), np.array([_WIDTH, self.sweep.bottom]))

    def _view(self, client: Any, low: Float, high: Float) -> None:
        """Show a rectangle of the plane, given by two corners (2,), as large as the window of a client allows.

        On a phone the controls cover the lower part of the window.
        """
        view, (width, height) = client.camera, np.maximum(high - low, 1e-3)
        free = 1.0 if view.aspect > 1 else _FREE_ON_PHONE
        visible = max(height / free, width / view.aspect)
        distance = visible / 2 / np.tan(view.fov / 2)
        centre = np.append((low + high) / 2 + [0, visible * (1 - free) / 2], 0.0)
        with client.atomic():
            view.up_direction = (0.0, -1.0, 0.0)
            view.position, view.look_at = centre - [0, 0, distance], centre

    def _zoom(self, event: Any) -> None:
        """Zoom to the rectangle that was drawn."""
        view = event.client.camera
        half = np.tan(view.fov / 2) * abs(view.position[2]) * np.array([view.aspect, 1.0])
        low, high = (view.position[:2] + (2 * np.array(c) - 1) * half for c in (event.screen_min, event.screen_max))
        self._view(event.client, low, high)

    def _fit_when_resized(self, client: Any) -> None:
        """Show the whole views to a new client, and whenever its window has another shape."""
        aspect = 0.0

        def resized(view: Any) -> None:
            nonlocal aspect
            if abs(view.aspect - aspect) > 1e-3:
                aspect = view.aspect
                self._show_whole(client)

        client.camera.on_update(resized)
        resized(client.camera)

    # ---- actions

    def _do(self, change: Callable[[], Any], notice: str = "") -> None:
        """Change the session and show it, or the error."""
        with self._lock:
            succeeded = self._succeeds(change)
            self._show_pairs()
            if succeeded and notice:
                self.tell(notice)

    def _clicked(self, event: Any) -> None:
        """Pick what was clicked, and show the whole views again, in which the counterpart is next."""
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        position = (origin - direction * origin[2] / direction[2])[:2]
        with self._lock:
            before = len(self.session.pairs)
            pixel, place = self.image.pixel(position), self.sweep.pixel(position)
            if pixel is not None:
                self._do(lambda: self.session.pick_pixel(pixel), "now the same point of the sweep")
            elif place is not None:
                self._do(lambda: self.session.pick_point(*place), "now the same point of the image")
            else:
                return
            if len(self.session.pairs) > before:
                self.tell(f"{len(self.session.pairs)} pairs of this frame, saved")
        self._show_whole(event.client)

    def _delete(self) -> None:
        if self.pair.value != _NO_PAIR:
            self.session.delete(int(self.pair.value) - 1)
            self.pair.value = _NO_PAIR

    def _finish(self) -> None:
        self.tell(f"done: {self.session.count} pairs in {self.session.path}; this page may be closed")
        self._viser.flush()
        self.done.set()

    # ---- what is shown

    def show(self, *, frame: bool = False) -> None:
        """Show the pairs of the session; with `frame` also the panels of a new frame."""
        with self._viser.atomic():
            if frame:
                self.image, self.sweep = arranged(self.session.camera, self.session.ranges)
                self._draw_panel("/image", self.session.image, self.image)
                self._draw_sweep()
                for client in self._viser.get_clients().values():
                    self._show_whole(client)
            self._show_pairs()

    def _show_pairs(self) -> None:
        count = len(self.session.pairs)
        self.pair.options = [_NO_PAIR, *(str(number + 1) for number in range(count))]
        self._list_frames()
        self._draw_marks()
        self.table.content = _table(self.session.pairs, self.session.residuals())
        self._show_status()

    def lines(self) -> list[str]:
        """Return the name of the frame, and what the pairs of all frames yield."""
        solved = self.session.solved
        if solved is None:
            return [self.session.name, f"a pose is estimated from {MIN_SOLVED_PAIRS} pairs on"]
        lines = [self.session.name, f"{status_text(solved.status)}: {solved.reason}"]
        if solved.accuracy is not None:
            rotation_deg, translation_m = solved.accuracy.rotation_deg, solved.accuracy.translation_m
            lines.append(f"predicted error (67 %): {rotation_deg:.2f} deg and {translation_m:.3f} m")
        return [*lines, *(["another pose fits nearly as well"] if solved.rival is not None else [])]

    def _frame_label(self, number: int) -> str:
        count = len(self.session.pairs_of_frame(number))
        return super()._frame_label(number) + (f" ({count})" if count else "")

    def _draw_panel(self, name: str, rgb: UInt8, panel: Panel) -> None:
        height = panel.bottom - panel.top
        centre = (_WIDTH / 2, panel.top + height / 2, 0.0)
        self._viser.scene.add_image(name, rgb, _WIDTH, height, format="png", position=centre)

    def _draw_sweep(self) -> None:
        drawn = self.session.ranges.drawn(self.layer.value).repeat(self.sweep.stretch, axis=0)
        # The browser interpolates between pixels: enlarged pixels keep their borders.
        times = int(np.clip(_MAX_TEXTURE_PX // max(drawn.shape[:2]), 1, _MAX_ENLARGEMENT))
        self._draw_panel("/sweep", drawn.repeat(times, axis=0).repeat(times, axis=1), self.sweep)

    def _draw_marks(self) -> None:
        """Draw a numbered cross at every pick, in both panels, and a line from a pixel to the point's projection."""
        session, scene = self.session, self._viser.scene
        pairs, residuals = session.pairs, session.residuals()
        segments: list[tuple[Float, str]] = []
        labels: list[tuple[str, Float]] = []

        def mark(panel: Panel, pixel: Any, text: str, colour: str, boxed: bool) -> None:
            (position,) = panel.position(np.array([pixel], np.float64))
            segments.extend((segment + position, colour) for segment in _cross(boxed))
            labels.append((text, position))

        for number, uv in enumerate(pairs.uv):
            state = _state(residuals, number)
            named = (str(number + 1), state, self.pair.value == str(number + 1))
            mark(self.image, uv, *named)
            if residuals.projected is not None and np.isfinite(residuals.projected[number]).all():
                segments.append((self.image.position(np.stack([uv, residuals.projected[number]])), state))
            pixel = session.ranges.pixel_of(pairs.xyz[number])
            if pixel is not None:
                mark(self.sweep, pixel, *named)
        if session.picked_uv is not None:
            mark(self.image, session.picked_uv, "?", "waiting", True)
        if session.picked_xyz is not None:
            mark(self.sweep, session.ranges.pixel_of(session.picked_xyz), "?", "waiting", True)
        with self._viser.atomic():
            for label in self._labels:
                label.remove()
            self._labels = [
                scene.add_label(f"/labels/{number}", text, position=(*(position + _MARK_GAP), _MARK_Z))
                for number, (text, position) in enumerate(labels)
            ]
            ends = np.array([segment for segment, _ in segments]).reshape(-1, 2, 2)
            colours = np.array([_COLOURS[colour] for _, colour in segments], np.uint8).reshape(-1, 1, 3).repeat(2, 1)
            for name, z, colour, thickness in (
                ("/border", _BORDER_Z, np.zeros_like(colours), 5.0),
                ("/marks", _MARK_Z, colours, 2.5),
            ):
                points = np.dstack([ends, np.full(ends.shape[:2], z)])
                scene.add_line_segments(name, points, colour, thickness=thickness, thickness_units="screen")


def _cross(boxed: bool) -> Float:
    """Return the segments (N, 2, 2) of a cross with an open centre, and of a square around it."""
    arms = [np.outer([_MARK_GAP, _MARK_ARM], step) for step in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    corners = _MARK_ARM * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.array([*arms, *(np.stack([corners, np.roll(corners, 1, 0)], 1) if boxed else [])])


def _state(residuals: Residuals, number: int) -> str:
    """Return whether a pair is "inlier" or "outlier" of the pose, or "open" without a pose."""
    if residuals.projected is None:
        return "open"
    return "inlier" if residuals.agrees[number] else "outlier"


def _table(pairs: PickedPairs, residuals: Residuals) -> str:
    """Return the pairs of a frame as an HTML table; outliers have the class "outlier"."""
    rows = ""
    for number, (uv, xyz, off_px) in enumerate(zip(pairs.uv, pairs.xyz, residuals.off_px, strict=True)):
        cells = [str(number + 1), ", ".join(f"{x:.1f}" for x in uv), ", ".join(f"{x:.3f}" for x in xyz)]
        cells.append(f"{off_px:.1f}" if np.isfinite(off_px) else "")
        state = _state(residuals, number)
        red = ' style="color:#ff6b6b"' if state == "outlier" else ""
        rows += f'<tr class="{state}"{red}>' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"
    head = "".join(f"<th>{title}</th>" for title in ("#", "u, v [px]", "x, y, z [m]", "error [px]"))
    style = "width:100%;font-size:0.8em;text-align:right;font-variant-numeric:tabular-nums"
    return f'<table class="pairs" style="{style}"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
