"""The page of `p2o view`, by viser: the session as sliders, buttons, pictures and a scene in space."""

from __future__ import annotations

import contextlib
import functools
import importlib
import io
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from html import escape
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, MethodUnavailable, P2OError, printable
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.nudge import AXES, Nudge
from p2o.viewer.session import ViewSession, Which
from p2o.viewer.shown_frame import Colouring

HOST = "127.0.0.1"
MOST_DEG, STEP_DEG = 10.0, 0.02
MOST_M, STEP_M = 1.0, 0.002
"""How far sliders go, and in what steps; "sliders to zero" begins again from there."""
_WHICH: tuple[Which, ...] = ("start", "result")
_COLOURS = {"start": (230, 159, 0), "result": (0, 158, 115), "now": (204, 121, 167)}
_COLOUR_NAMES = {"start": "orange", "result": "green"}
_MOST_FRAMES = 500
"""So many frames can be chosen from on the page; of more the first are."""
_FRUSTUM_M = 1.5
_OVERLAY_PX, _OVERLAY_HIGH_PX = 760, 430
_MARGIN_PX = 20
_JPEG = 85


class ViewServer:
    """Serves one session on `host` until it is closed; use it in a `with`. `url` is the address of the page.

    Pages of other origins get no connection, and nothing is handed on to the web. Any change is shown to all who look.
    Raises MethodUnavailable where viser is not installed, InputError where the port is taken or not allowed.
    """

    def __init__(self, session: ViewSession, host: str = HOST, port: int = 0) -> None:
        self.session, self.host, self.port = session, host, _free_port(host, port)
        viser = require_viser()

        class _Server(viser.ViserServer):  # type: ignore[name-defined, misc]
            """A server that no page can ask to hand on what it shows to the web."""

            def request_share_url(self, verbose: bool = True) -> str | None:
                return None

        with _unheard(), _same_origin(host, self.port):
            self._viser = _Server(host=host, port=self.port, label="p2o view", verbose=False)
        if self._viser.get_port() != self.port:
            self.close()
            raise _port_taken(host, self.port)
        self._lock, self._wanted, self._still, self._notice = threading.RLock(), 0, False, ""
        self.sliders: dict[str, Any] = {}
        self._frustum: dict[str, Any] = {}
        self._build()
        self._place_axes()
        self.show(frame=True)

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://{'localhost' if self.host in ('0.0.0.0', '::') else self.host}:{self.port}/"

    def __enter__(self) -> ViewServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        with _unheard():
            self._viser.stop()

    # ---- the page

    def _build(self) -> None:
        """Make all that there is to press."""
        gui, session = self._viser.gui, self.session
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", dark_mode=True)
        names = [f"{number}: {printable(name)}" for number, name in enumerate(session.names[:_MOST_FRAMES])]
        if len(names) > 1:
            self.frames = gui.add_dropdown("frame", names, initial_value=names[0])
            self.frames.on_update(lambda _: self._do(self._look_at, frame=True))
        self.status = gui.add_html("")
        with gui.add_folder("Pose of now"):
            self.begin = {}
            for which in _WHICH:
                self.begin[which] = gui.add_button(f"begin at the {which}")
                self.begin[which].on_click(functools.partial(self._begin_at, which))
            self.axes = gui.add_dropdown("axes of", AXES, initial_value=session.nudge.axes)
            self.axes.on_update(lambda _: self._do(lambda: session.settle(self.axes.value), still=True))
            for kind, most, step, unit in (("turn", MOST_DEG, STEP_DEG, "deg"), ("shift", MOST_M, STEP_M, "m")):
                for axis in "xyz":
                    slider = gui.add_slider(f"{kind} {axis} [{unit}]", -most, most, step, 0.0)
                    slider.on_update(lambda _: self._do(self._move))
                    self.sliders[f"{kind} {axis}"] = slider
            zero = gui.add_button("sliders to zero, the pose stays")
            zero.on_click(lambda _: self._do(lambda: session.settle(self.axes.value), still=True))
        self.write = gui.add_button(f"write {printable(session.out.name)}", color="green")
        self.write.on_click(lambda _: self._do(self._write))
        if session.calibrates:
            self.calibrate = gui.add_button("calibrate from here")
            self.calibrate.on_click(lambda _: self._calibrated())
        with gui.add_folder("What is shown"):
            self.by = gui.add_dropdown("cloud by", session.shown.colourings, initial_value="range")
            self.by.on_update(lambda _: self._do(lambda: None))
            self.point_size = gui.add_slider("point size [cm]", 0.5, 15.0, 0.5, 4.0)
            self.point_size.on_update(lambda _: self._do(lambda: None))
            self.shows = {}
            for name, colour in _COLOUR_NAMES.items():
                self.shows[name] = gui.add_checkbox(f"{name} ({colour})", True)
                self.shows[name].on_update(lambda _: self._do(lambda: None))
            self.shows["picture"] = gui.add_checkbox("image in space", True)
            self.shows["picture"].on_update(lambda _: self._do(lambda: None))
            look = gui.add_button("look through the camera", hint="It puts the image away, which hides the sweep.")
            look.on_click(self._look_through)
        panel = gui.add_panel()
        with panel.add_tab("sweep on image"):
            self.overlay = gui.add_image(session.overlay(), format="jpeg", jpeg_quality=_JPEG)
        camera = session.shown.camera
        width = min(_OVERLAY_PX, _OVERLAY_HIGH_PX * camera.width / camera.height, camera.width + _MARGIN_PX)
        panel.float(x=12, y=-12, width=width)
        # On a phone it is a section below the others, closed unless this is said.
        panel.expand()

    def show(self, *, frame: bool = False) -> None:
        """Show the session as it is; with `frame` its picture and points, too."""
        scene, session, shown = self._viser.scene, self.session, self.session.shown
        pose = session.pose
        with self._viser.atomic():
            self._names_of_axes()
            by: Colouring = next((by for by in shown.colourings if by == self.by.value), "range")
            colours = shown.colours(by, pose)
            if frame:
                self.cloud = scene.add_point_cloud(
                    "/sweep", shown.thinned.xyz.astype(np.float32), colours, precision="float32", point_shading="flat"
                )
                for handle in self._frustum.values():
                    handle.remove()
                self._frustum.clear()
                self._place_frustum("/now/camera", np.eye(4), "now")
                self._place_frustum("/now/picture", np.eye(4), "picture", shown.legible)
            elif not np.array_equal(self.cloud.colors, colours):
                self.cloud.colors = colours
            self.cloud.point_size = self.point_size.value / 100
            self.now.wxyz, self.now.position = _placed(pose)
            self._frustum["picture"].visible = self.shows["picture"].value
            for name, known in zip(_WHICH, (session.start, session.result), strict=True):
                if known is not None:
                    self._place_frustum(f"/{name}", known.camera_from_lidar, name)
                    self._frustum[name].visible = self.shows[name].value
                self.shows[name].disabled = self.begin[name].disabled = known is None
            self.overlay.image = session.overlay("reflectance" if by == "reflectance" else "range")
            self._say()

    def _place_axes(self) -> None:
        """Put the axes of both sensors into the scene, and whoever comes behind the camera."""
        scene, pose = self._viser.scene, self.session.pose
        scene.add_frame("/LiDAR", axes_length=1.0, axes_radius=0.02, origin_radius=0.04)
        self.now = scene.add_frame("/now", axes_length=0.6, axes_radius=0.015, origin_radius=0.03)
        lidar_from_camera = se3.inverse(pose)
        scene.set_up_direction(tuple(-lidar_from_camera[:3, 1]))
        camera = self._viser.initial_camera
        camera.position, camera.look_at = (se3.apply(lidar_from_camera, np.array([p]))[0] for p in _BEHIND_AND_AHEAD)

    def _place_frustum(self, place: str, camera_from_lidar: Float, name: str, picture: Any = None) -> None:
        shown = self.session.shown
        wxyz, position = _placed(camera_from_lidar)
        if name in self._frustum and picture is None:
            self._frustum[name].wxyz, self._frustum[name].position = wxyz, position
            return
        self._frustum[name] = self._viser.scene.add_camera_frustum(
            place,
            fov=shown.upward_view_rad,
            aspect=shown.camera.width / shown.camera.height,
            scale=_FRUSTUM_M,
            color=_COLOURS.get(name, _COLOURS["now"]),
            image=picture,
            format="jpeg",
            jpeg_quality=_JPEG,
            wxyz=wxyz,
            position=position,
        )

    def _names_of_axes(self) -> None:
        """Say on the sliders where their axes point to."""
        names = ("x (right)", "y (down)", "z (forward)") if self.session.nudge.axes == "camera" else ("x", "y", "z")
        for kind, unit in (("turn", "deg"), ("shift", "m")):
            for axis, name in zip("xyz", names, strict=True):
                label = f"{kind} {name} [{unit}]"
                if self.sliders[f"{kind} {axis}"].label != label:
                    self.sliders[f"{kind} {axis}"].label = label

    # ---- what is pressed

    def _do(self, change: Callable[[], Any], *, still: bool = False, frame: bool = False) -> None:
        """Change the session and show it; of changes that come faster than they are shown the last one is.

        With `still` the sliders go back to zero, which is no change of its own.
        """
        if self._still:
            return
        self._wanted += 1
        mine = self._wanted
        with self._lock:
            self._notice = ""
            try:
                change()
            except P2OError as problem:
                self.tell(str(problem))
                return
            if still:
                self._still = True
                try:
                    for slider in self.sliders.values():
                        slider.value = 0.0
                finally:
                    self._still = False
            if frame or mine == self._wanted:
                self.show(frame=frame)

    def _begin_at(self, which: Which, _: object) -> None:
        self._do(lambda: self.session.begin_at(which), still=True)

    def _move(self) -> None:
        turn, shift = (tuple(self.sliders[f"{kind} {axis}"].value for axis in "xyz") for kind in ("turn", "shift"))
        self.session.nudge = Nudge(self.session.nudge.axes, turn, shift)

    def _look_at(self) -> None:
        self.session.look_at(int(self.frames.value.partition(":")[0]))
        self.by.options = self.session.shown.colourings

    def _write(self) -> None:
        path = self.session.write()
        self.tell(f"wrote {path}: p2o run --start {path}")

    def _calibrated(self) -> None:
        """Calibrate, which takes seconds, while the page goes on; then the result is there to begin at."""
        self.calibrate.disabled, self.calibrate.label = True, "calibrating ..."
        try:
            said = self.session.calibrate()
        except P2OError as problem:
            self.tell(str(problem))
        else:
            self._do(lambda: None)
            self.tell(f'{said}; it is shown in {_COLOUR_NAMES["result"]}, and "begin at the result" takes it')
        finally:
            self.calibrate.disabled, self.calibrate.label = False, "calibrate from here"

    def _look_through(self, event: Any) -> None:
        """Put the eye of who pressed it into the camera, and the picture away, which would hide the sweep."""
        lidar_from_camera = se3.inverse(self.session.pose)
        ahead = se3.apply(lidar_from_camera, np.array([[0.0, 0.0, 5.0]]))[0]
        eye = event.client.camera
        with event.client.atomic():
            eye.up_direction = -lidar_from_camera[:3, 1]
            eye.position, eye.look_at = lidar_from_camera[:3, 3], ahead
            eye.fov = _high_enough(self.session.shown.camera, eye.aspect)
        self.shows["picture"].value = False

    def tell(self, text: str) -> None:
        """Say something on the page."""
        with self._lock:
            self._notice = text
            self._say()

    def _say(self) -> None:
        notice = [self._notice] if self._notice else []
        self.status.content = _html([self.session.shown.name, *self.session.lines(), *notice])


_WIDEST_RAD = 2.4
_BEHIND_AND_AHEAD = ([0.0, -2.5, -6.0], [0.0, 0.5, 12.0])
"""Where who comes stands, and looks to, in the camera's axes, in metres."""


def _placed(camera_from_lidar: Float) -> tuple[Float, Float]:
    """Return the quaternion w x y z and the place of the camera in the LiDAR's frame."""
    from scipy.spatial.transform import Rotation

    lidar_from_camera = se3.inverse(camera_from_lidar)
    x, y, z, w = Rotation.from_matrix(lidar_from_camera[:3, :3]).as_quat()
    return np.array([w, x, y, z]), lidar_from_camera[:3, 3]


def _high_enough(camera: Camera, aspect: float) -> float:
    """Return the height in radians of a view that holds the image, in a window of so many heights of width."""
    high = max(camera.height, camera.width / aspect)
    return min(2 * float(np.arctan(high / (2 * camera.focal_px))), _WIDEST_RAD)


def _html(lines: Sequence[str]) -> str:
    first, *rest = (escape(printable(line, 500)) for line in lines)
    style = "margin:2px 0;font-size:0.8em;line-height:1.3;overflow-wrap:anywhere"
    return (
        f'<div style="padding:0 0.8em"><b>{first}</b>' + "".join(f'<p style="{style}">{t}</p>' for t in rest) + "</div>"
    )


def require_viser() -> Any:
    """Return the package; raises MethodUnavailable where it is not installed."""
    try:
        return importlib.import_module("viser")
    except ModuleNotFoundError as problem:
        raise MethodUnavailable(
            "p2o view needs the package viser, which is not installed", hint='run: pip install "viser>=1.1"'
        ) from problem


def _free_port(host: str, port: int) -> int:
    """Return the port, or any free one for 0; viser itself would take the next one without a word."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as problem:
        raise _port_taken(host, port, problem) from problem


def _port_taken(host: str, port: int, problem: Exception | None = None) -> InputError:
    return InputError(
        "the port cannot be used",
        where=f"{host}:{port}",
        got=getattr(problem, "strerror", None) or problem,
        hint="leave --port out, or name another",
    )


@contextlib.contextmanager
def _same_origin(host: str, port: int) -> Iterator[None]:
    """Let the server that viser starts meanwhile take connections of its own page alone.

    It asks nobody where they come from: any page of the web that is open beside it could read pictures and clouds.
    """
    import re

    from websockets.asyncio import server

    origins: list[Any] = [f"http://{name}:{port}" for name in ("localhost", HOST, host)]
    if host not in (HOST, "localhost"):
        # Others reach it by names that nobody here knows.
        origins.append(re.compile(rf"http://[^/]+:{port}"))
    serve = server.serve
    server.serve = functools.partial(serve, origins=origins)
    try:
        yield
    finally:
        server.serve = serve


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Keep what viser prints off the terminal: it is for what the user has to know."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
