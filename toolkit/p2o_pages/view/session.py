"""State of `p2o view`: the current frame, its known poses, the current pose, and the file to which it is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from p2o.arrays import Float, UInt8
from p2o.draw.sweep_image import By
from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.frames.frame import Frame
from p2o.geometry.pose_error import pose_error
from p2o.host.calibration_file import names_file
from p2o.host.registry import Registry
from p2o.results.result import Result, Status
from p2o.run.recipe import open_exporter

from p2o_pages.view.nudge import Axes, Nudge
from p2o_pages.view.shown_frame import MOST_POINTS, ShownFrame

Which = Literal["start", "result"]


@dataclass(frozen=True, eq=False)
class KnownPose:
    """A camera_from_lidar (4, 4) and its description in a few words."""

    camera_from_lidar: Float
    description: str


@dataclass(frozen=True, eq=False)
class Opened:
    """A frame, its initial guess, and its result if there is one."""

    frame: Frame
    start: KnownPose
    result: KnownPose | None = None


Open = Callable[[int], Opened]
Calibrate = Callable[[Frame, Float], KnownPose]


class ViewSession:
    """One frame at a time, and one pose that is kept when another frame is shown. Not thread-safe.

    `open_frame` reads a frame by its number in `names`; `calibrate` calibrates a frame from an initial guess; `out` is
    the file of `write`; `registry` (default: that of the process) has the exporter `text`, which writes the file.

    Raises InputError for a file name that `--start` would not accept, and as `open_frame` for the first frame.
    """

    def __init__(
        self,
        names: Sequence[str],
        open_frame: Open,
        calibrate: Calibrate,
        out: Path | str = "start.yaml",
        most_points: int = MOST_POINTS,
        registry: Registry | None = None,
    ):
        text = str(out)
        if not names_file(text) or set(text) & set("#?"):
            raise InputError("--start rejects this file name", where="--out", expected="such as start.yaml", got=text)
        self.names, self.out = tuple(names), expanded(text)
        if not self.out.parent.is_dir():
            raise InputError("the folder of the start is missing", where=self.out.parent, expected="a folder")
        self._open, self._calibrate, self._most_points = open_frame, calibrate, most_points
        self._registry = Registry.of_process() if registry is None else registry
        self._results: dict[int, KnownPose] = {}
        self.written: Path | None = None
        self.look_at(0)
        self.nudge = Nudge()
        self._base = (self.result or self.start).camera_from_lidar

    def look_at(self, number: int) -> None:
        """Show another frame at the current pose; if it cannot be read, the error is raised and nothing changes."""
        opened = self._open(number)
        self.shown = ShownFrame.of(opened.frame, self._most_points)
        self.number, self.frame, self.start, self._stored_result = number, opened.frame, opened.start, opened.result

    @property
    def result(self) -> KnownPose | None:
        """The last result of `calibrate` for this frame, else that of the run."""
        return self._results.get(self.number, self._stored_result)

    @property
    def pose(self) -> Float:
        """The current camera_from_lidar (4, 4)."""
        return self.nudge.applied(self._base)

    def begin_at(self, which: Which) -> None:
        """Set the current pose to the start or to the result; without a result nothing changes."""
        known = self.start if which == "start" else self.result
        if known is not None:
            self._base, self.nudge = known.camera_from_lidar, Nudge(self.nudge.axes)

    def settle(self, axes: Axes) -> None:
        """Keep the current pose, and apply further motion along `axes`."""
        self._base, self.nudge = self.pose, Nudge(axes)

    def overlay(self, by: By = "range") -> UInt8:
        """Return the image (H, W, 3) with the sweep projected at the current pose."""
        return self.shown.overlay(self.pose, by)

    def lines(self) -> list[str]:
        """Describe the current pose: points in the image, difference from the start and from the result."""
        pose, total = self.pose, len(self.shown.cloud)
        lines = [f"{self.shown.seen(pose)} of {total} points of the sweep in the image"]
        if len(self.shown.thinned) < total:
            lines[0] += f"; {len(self.shown.thinned)} are shown in 3-D"
        for name, known in (("start", self.start), ("result", self.result)):
            if known is not None:
                step = pose_error(pose, known.camera_from_lidar)
                size = f"{step.rotation_deg:.2f} deg and {100 * step.translation_m:.1f} cm"
                lines.append(f"{size} from the {name} ({known.description})")
        return lines

    def write(self) -> Path:
        """Write the current pose as a file for `--start`, and return its path; InputError if it cannot be written."""
        export, path = open_exporter(f"text:{self.out}", self._registry)
        start = self.start.camera_from_lidar
        export(Result((self.frame.name,), start, self.pose, Status.CONVERGED, "set by hand"), path)
        self.written = self.out
        return self.out

    def calibrate(self) -> str:
        """Calibrate the current frame from the current pose, store the result and return its description."""
        number, frame = self.number, self.frame
        self._results[number] = self._calibrate(frame, self.pose)
        return self._results[number].description
