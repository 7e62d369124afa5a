"""What `p2o view` knows while someone looks: a frame, the poses to choose from, the pose of now, and its file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from p2o.arrays import Float, UInt8
from p2o.draw.sweep_picture import By
from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.files.whole_file import write_whole
from p2o.formats.calibration import Calibration
from p2o.formats.files import format_named, names_file
from p2o.frames.frame import Frame
from p2o.geometry.nudge import Axes, Nudge
from p2o.geometry.pose_error import pose_error
from p2o.viewer.shown_frame import MOST_POINTS, ShownFrame

Which = Literal["start", "result"]


@dataclass(frozen=True, eq=False)
class KnownPose:
    """A camera_from_lidar (4, 4) and what it is in a few words."""

    camera_from_lidar: Float
    said: str


@dataclass(frozen=True, eq=False)
class Opened:
    """A frame, where its calibration begins, and how it ended where that is known."""

    frame: Frame
    start: KnownPose
    result: KnownPose | None = None


Open = Callable[[int], Opened]
Calibrate = Callable[[Frame, Float], KnownPose]


class ViewSession:
    """One frame at a time of some, and one pose that stays when another frame is looked at.

    `open_frame` reads a frame by its number in `names`, `out` is the file of `write`; `calibrate` makes a result of a
    frame and a start. Not for several threads at once.

    Raises InputError for a file that `--start` would not take for one, and as `open_frame` for the first frame.
    """

    def __init__(
        self,
        names: Sequence[str],
        open_frame: Open,
        out: Path | str = "start.yaml",
        calibrate: Calibrate | None = None,
        most_points: int = MOST_POINTS,
    ):
        text = str(out)
        if not names_file(text) or set(text) & set("#?"):
            raise InputError("this name is no file to --start", where="--out", expected="such as start.yaml", got=text)
        self.names, self.out = tuple(names), expanded(text)
        if not self.out.parent.is_dir():
            raise InputError("the folder of the start is missing", where=self.out.parent, expected="a folder")
        self._open, self._calibrate, self._most_points = open_frame, calibrate, most_points
        self._results: dict[int, KnownPose] = {}
        self.written: Path | None = None
        self.look_at(0)
        self.nudge = Nudge()
        self._base = (self.result or self.start).camera_from_lidar

    def look_at(self, number: int) -> None:
        """Look at another frame, from the pose of now; where it cannot be read nothing changes but the error raised."""
        opened = self._open(number)
        self.shown = ShownFrame.of(opened.frame, self._most_points)
        self.number, self.frame, self.start, self._told = number, opened.frame, opened.start, opened.result

    @property
    def result(self) -> KnownPose | None:
        """The result that was found here last, or the one that the run has."""
        return self._results.get(self.number, self._told)

    @property
    def pose(self) -> Float:
        """The camera_from_lidar (4, 4) of now."""
        return self.nudge.applied(self._base)

    def begin_at(self, which: Which) -> None:
        """Take the start or the result as the pose of now, moved by nothing; without a result nothing changes."""
        known = self.start if which == "start" else self.result
        if known is not None:
            self._base, self.nudge = known.camera_from_lidar, Nudge(self.nudge.axes)

    def settle(self, axes: Axes) -> None:
        """Keep the pose of now, and move it from there on along `axes`."""
        self._base, self.nudge = self.pose, Nudge(axes)

    def overlay(self, by: By = "range") -> UInt8:
        """Return the sweep over the picture (H, W, 3) at the pose of now."""
        return self.shown.overlay(self.pose, by)

    def lines(self) -> list[str]:
        """Return what there is to say about the pose of now."""
        pose, total = self.pose, len(self.shown.cloud)
        lines = [f"{self.shown.seen(pose)} of {total} points of the sweep in the image"]
        if len(self.shown.thinned) < total:
            lines[0] += f"; {len(self.shown.thinned)} stand in space"
        for name, known in (("start", self.start), ("result", self.result)):
            if known is not None:
                step = pose_error(pose, known.camera_from_lidar)
                size = f"{step.rotation_deg:.2f} deg and {100 * step.translation_m:.1f} cm"
                lines.append(f"{size} from the {name} ({known.said})")
        return lines

    def write(self) -> Path:
        """Write the pose of now as a file for `--start`, and return its path; InputError where it cannot be written."""
        write_whole(self.out, format_named("text").written(Calibration(None, self.pose)))
        self.written = self.out
        return self.out

    @property
    def calibrates(self) -> bool:
        """True where there is a method to calibrate with."""
        return self._calibrate is not None

    def calibrate(self) -> str:
        """Calibrate the frame of now from the pose of now, keep the result and return it in words."""
        assert self._calibrate is not None
        number, frame = self.number, self.frame
        found = self._calibrate(frame, self.pose)
        self._results[number] = found
        return found.said
