"""The page of `p2o view`: sliders, buttons, images and a scene in space."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.errors import InputError, P2OError, printable
from p2o.geometry import se3
from p2o.geometry.camera import Camera

from p2o_pages.server import HOST, PageServer
from p2o_pages.view.nudge import AXES, Nudge
from p2o_pages.view.session import ViewSession, Which
from p2o_pages.view.shown_frame import Colouring

MOST_DEG, STEP_DEG = 10.0, 0.02
MOST_M, STEP_M = 1.0, 0.002
"""Range and step of the sliders; "sliders to zero" starts again from the current pose."""
_WHICH: tuple[Which, ...] = ("start", "result")
_COLOURS = {"start": (230, 159, 0), "result": (0, 158, 115), "now": (204, 121, 167)}
_COLOUR_NAMES = {"start": "orange", "result": "green"}
_FRUSTUM_M = 1.5
_OVERLAY_PX, _OVERLAY_HIGH_PX = 760, 430
_MARGIN_PX = 20
_JPEG = 85


class ViewServer(PageServer):
    """Serves the page of one session; raises as PageServer."""

    session: ViewSession

    def __init__(self, session: ViewSession, host: str = HOST, port: int = 0) -> None:
        super().__init__("p2o view", session, host, port)
        self._last_request, self._resetting = 0, False
        self.sliders: dict[str, Any] = {}
        self._frustum: dict[str, Any] = {}
        self._build()
        self._place_axes()
        self.show(frame=True)

    # ---- the page

    def _build(self) -> None:
        """Add all controls."""
        gui, session = self._viser.gui, self.session
        with gui.add_folder("Current pose"):
            self.begin = {which: gui.add_button(f"begin at the {which}") for which in _WHICH}
            for which, button in self.begin.items():
                button.on_click(functools.partial(self._begin_at, which))
            self.axes = gui.add_dropdown("axes of", AXES, initial_value=session.nudge.axes)
            self.axes.on_update(lambda _: self._do(lambda: session.settle(self.axes.value), reset_sliders=True))
            for kind, most, step, unit in (("turn", MOST_DEG, STEP_DEG, "deg"), ("shift", MOST_M, STEP_M, "m")):
                for axis in "xyz":
                    slider = gui.add_slider(f"{kind} {axis} [{unit}]", -most, most, step, 0.0)
                    slider.on_update(lambda _: self._do(self._move))
                    self.sliders[f"{kind} {axis}"] = slider
            zero = gui.add_button("sliders to zero, keep the pose")
            zero.on_click(lambda _: self._do(lambda: session.settle(self.axes.value), reset_sliders=True))
        self.write = gui.add_button(f"write {printable(session.out.name)}", color="green")
        self.write.on_click(lambda _: self._do(self._write))
        self.calibrate = gui.add_button("calibrate from here")
        self.calibrate.on_click(lambda _: self._calibrated())
        with gui.add_folder("Display"):
            self.by = gui.add_dropdown("cloud by", session.shown.colourings, initial_value="range")
            self.point_size = gui.add_slider("point size [cm]", 0.5, 15.0, 0.5, 4.0)
            labels = {
                **{name: f"{name} ({colour})" for name, colour in _COLOUR_NAMES.items()},
                "image": "image in space",
            }
            self.shows = {name: gui.add_checkbox(label, True) for name, label in labels.items()}
            for control in (self.by, self.point_size, *self.shows.values()):
                control.on_update(lambda _: self._do(lambda: None))
            look = gui.add_button("look through the camera", hint="Hides the image, which covers the sweep.")
            look.on_click(self._look_through)
        panel = gui.add_panel()
        with panel.add_tab("sweep on image"):
            self.overlay = gui.add_image(session.overlay(), format="jpeg", jpeg_quality=_JPEG)
        camera = session.shown.camera
        width = min(_OVERLAY_PX, _OVERLAY_HIGH_PX * camera.width / camera.height, camera.width + _MARGIN_PX)
        panel.float(x=12, y=-12, width=width)
        # On a phone it is a section below the others, collapsed by default.
        panel.expand()

    def show(self, *, frame: bool = False) -> None:
        """Show the pose of the session; with `frame` also the image and points of a new frame."""
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
                self.by.options = shown.colourings
                for handle in self._frustum.values():
                    handle.remove()
                self._frustum.clear()
                self._place_frustum("/now/camera", np.eye(4), "now")
                self._place_frustum("/now/image", np.eye(4), "image", shown.legible)
            elif not np.array_equal(self.cloud.colors, colours):
                self.cloud.colors = colours
            self.cloud.point_size = self.point_size.value / 100
            self.now.wxyz, self.now.position = _pose_in_scene(pose)
            self._frustum["image"].visible = self.shows["image"].value
            for name, known in zip(_WHICH, (session.start, session.result), strict=True):
                if known is not None:
                    self._place_frustum(f"/{name}", known.camera_from_lidar, name)
                    self._frustum[name].visible = self.shows[name].value
                self.shows[name].disabled = self.begin[name].disabled = known is None
            self.overlay.image = session.overlay("reflectance" if by == "reflectance" else "range")
            self._show_status()

    def _place_axes(self) -> None:
        """Add the axes of both sensors to the scene, and set the initial view behind the camera."""
        scene, pose = self._viser.scene, self.session.pose
        scene.add_frame("/LiDAR", axes_length=1.0, axes_radius=0.02, origin_radius=0.04)
        self.now = scene.add_frame("/now", axes_length=0.6, axes_radius=0.015, origin_radius=0.03)
        lidar_from_camera = se3.inverse(pose)
        scene.set_up_direction(tuple(-lidar_from_camera[:3, 1]))
        camera = self._viser.initial_camera
        camera.position, camera.look_at = (se3.apply(lidar_from_camera, np.array([p]))[0] for p in _BEHIND_AND_AHEAD)

    def _place_frustum(self, place: str, camera_from_lidar: Float, name: str, image: Any = None) -> None:
        shown = self.session.shown
        wxyz, position = _pose_in_scene(camera_from_lidar)
        if name in self._frustum and image is None:
            self._frustum[name].wxyz, self._frustum[name].position = wxyz, position
            return
        self._frustum[name] = self._viser.scene.add_camera_frustum(
            place,
            fov=shown.upward_view_rad,
            aspect=shown.camera.width / shown.camera.height,
            scale=_FRUSTUM_M,
            color=_COLOURS.get(name, _COLOURS["now"]),
            image=image,
            format="jpeg",
            jpeg_quality=_JPEG,
            wxyz=wxyz,
            position=position,
        )

    def _names_of_axes(self) -> None:
        """Write the directions of the axes on the sliders."""
        names = ("x (right)", "y (down)", "z (forward)") if self.session.nudge.axes == "camera" else ("x", "y", "z")
        for kind, unit in (("turn", "deg"), ("shift", "m")):
            for axis, name in zip("xyz", names, strict=True):
                label = f"{kind} {name} [{unit}]"
                if self.sliders[f"{kind} {axis}"].label != label:
                    self.sliders[f"{kind} {axis}"].label = label

    # ---- actions

    def _do(self, change: Callable[[], Any], *, reset_sliders: bool = False) -> None:
        """Change the session and show it; only the last of several pending changes is shown.

        `reset_sliders` moves the sliders to zero without treating that as a change.
        """
        if self._resetting:
            return
        self._last_request += 1
        request = self._last_request

        def change_and_show() -> None:
            self._check_controls()
            change()
            if reset_sliders:
                self._resetting = True
                try:
                    for slider in self.sliders.values():
                        slider.value = 0.0
                finally:
                    self._resetting = False
            if request == self._last_request:
                self.show()

        with self._lock:
            self._succeeds(change_and_show)

    def _check_controls(self) -> None:
        """Raise InputError for a value that the page does not offer, as a foreign client may send; it is set back."""
        numbers = [(slider, 0.0, -slider.max, slider.max) for slider in self.sliders.values()]
        for control, default, low, high in (*numbers, (self.point_size, 4.0, 0.5, 15.0)):
            value = control.value
            if not low <= value <= high:
                control.value = default
                raise InputError("invalid value", where=control.label, expected=f"{low:g} to {high:g}", got=value)
        if self.axes.value not in AXES:
            value, self.axes.value = self.axes.value, self.session.nudge.axes
            raise InputError("unknown axes", expected=" or ".join(AXES), got=value)

    def _begin_at(self, which: Which, _: object) -> None:
        self._do(lambda: self.session.begin_at(which), reset_sliders=True)

    def _move(self) -> None:
        turn, shift = (tuple(self.sliders[f"{kind} {axis}"].value for axis in "xyz") for kind in ("turn", "shift"))
        self.session.nudge = Nudge(self.session.nudge.axes, turn, shift)

    def _write(self) -> None:
        path = self.session.write()
        self.tell(f"wrote {path}: p2o run --start {path}")

    def _calibrated(self) -> None:
        """Calibrate, which takes seconds, without blocking the page; then show the result."""
        self.calibrate.disabled, self.calibrate.label = True, "calibrating ..."
        try:
            summary = self.session.calibrate()
        except P2OError as problem:
            self.tell(str(problem))
        else:
            self._do(lambda: None)
            self.tell(f'{summary}; it is shown in {_COLOUR_NAMES["result"]}, and "begin at the result" takes it')
        finally:
            self.calibrate.disabled, self.calibrate.label = False, "calibrate from here"

    def _look_through(self, event: Any) -> None:
        """Move the view of this client into the camera, and hide the image, which would cover the sweep."""
        lidar_from_camera = se3.inverse(self.session.pose)
        ahead = se3.apply(lidar_from_camera, np.array([[0.0, 0.0, 5.0]]))[0]
        view = event.client.camera
        with event.client.atomic():
            view.up_direction = -lidar_from_camera[:3, 1]
            view.position, view.look_at = lidar_from_camera[:3, 3], ahead
            view.fov = _vertical_fov_rad(self.session.shown.camera, view.aspect)
        self.shows["image"].value = False

    def lines(self) -> list[str]:
        """Return the name of the frame, and the description of the current pose."""
        return [self.session.shown.name, *self.session.lines()]


_MAX_FOV_RAD = 2.4
_BEHIND_AND_AHEAD = ([0.0, -2.5, -6.0], [0.0, 0.5, 12.0])
"""Initial viewpoint and the point it looks at, in the camera frame [m]."""


def _pose_in_scene(camera_from_lidar: Float) -> tuple[Float, Float]:
    """Return the quaternion w x y z and the position of the camera in the LiDAR frame."""
    from scipy.spatial.transform import Rotation

    lidar_from_camera = se3.inverse(camera_from_lidar)
    x, y, z, w = Rotation.from_matrix(lidar_from_camera[:3, :3]).as_quat()
    return np.array([w, x, y, z]), lidar_from_camera[:3, 3]


def _vertical_fov_rad(camera: Camera, aspect: float) -> float:
    """Return the vertical field of view [rad] that contains the image in a window of this aspect (width / height)."""
    high = max(camera.height, camera.width / aspect)
    return min(2 * float(np.arctan(high / (2 * camera.focal_px))), _MAX_FOV_RAD)
