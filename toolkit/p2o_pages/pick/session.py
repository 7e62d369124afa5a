"""State of `p2o pick`: one frame at a time, the pairs of all frames, and their file, written after every change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from p2o.arrays import Bool, Float
from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.frames.frame import Dataset, Frame
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.problems.picked_pairs import PickedPairs, read_pairs, write_pairs
from p2o.problems.picked_pose import PickedFrame, PickedPose, solve_picks

from p2o_pages.pick.range_image import range_image, sector_of

MIN_SOLVED_PAIRS = 4
"""The pose is estimated from this number of pairs on, counted over all frames."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """For each pair of a frame: its error `off_px` (N,), NaN if unknown, and whether it is an inlier, `agrees` (N,).

    `projected` (N, 2) are the pixels of the points at the estimated pose, None without a pose.
    """

    off_px: Float
    agrees: Bool
    projected: Float | None


class PickSession:
    """One frame at a time of a dataset, and pairs of several frames in one file. Not thread-safe.

    `indices` are the numbers in the dataset of the frames `names`. PickedPairs of other frames in the file are kept.
    `picked_uv` (2,) and `picked_xyz` (3,) are the picks that wait for their counterpart, or None.

    Raises InputError if the file has another form, its folder is missing, or the first frame cannot be read.
    """

    picked_uv: Float | None
    picked_xyz: Float | None

    def __init__(self, dataset: Sequence[Frame] | Dataset, names: Sequence[str], indices: Sequence[int], path: Path):
        self.names, self.path = tuple(names), expanded(path)
        self._dataset, self._indices = dataset, tuple(indices)
        if not self.path.parent.is_dir():
            raise InputError("the folder of the pairs is missing", where=self.path.parent, expected="a folder")
        self._pairs: dict[str, PickedPairs] = read_pairs(self.path) if self.path.exists() else {}
        self._cameras: dict[int, Camera] = {}
        self.solved: PickedPose | None = None
        self.look_at(0)

    def look_at(self, number: int) -> None:
        """Show another frame and discard a pick without counterpart; if it cannot be read, nothing changes."""
        frame = self._dataset[self._indices[number]]
        ranges = range_image(frame.cloud, sector_of(frame))
        self.number, self.image, self.camera, self.ranges = number, frame.image.rgb, frame.camera, ranges
        self._cameras[number] = frame.camera
        self.forget()

    @property
    def name(self) -> str:
        """The name of the current frame."""
        return self.names[self.number]

    @property
    def pairs(self) -> PickedPairs:
        """The pairs of the current frame."""
        return self.pairs_of_frame(self.number)

    def pairs_of_frame(self, number: int) -> PickedPairs:
        """Return the pairs of a frame."""
        return self._pairs.get(self.names[number], PickedPairs.none())

    @property
    def count(self) -> int:
        """The number of pairs of all frames of the session."""
        return sum(len(self.pairs_of_frame(number)) for number in range(len(self.names)))

    # ---- picking

    def pick_pixel(self, uv: Float) -> None:
        """Take a pixel (2,); with a point that waits it becomes a pair, in the file. Raises as `delete`."""
        self.picked_uv = np.round(uv, 2)
        self._add_pair()

    def pick_point(self, column: float, row: float) -> None:
        """Take the point nearest to a position in the range image, in the same way.

        Raises InputError if no point is near; otherwise as `delete`.
        """
        filled = self.ranges.nearest(column, row)
        if filled is None:
            raise InputError("there is no point near; zoom in")
        self.picked_xyz = np.round(self.ranges.xyz[self.ranges.index[filled[1], filled[0]]], 6)
        self._add_pair()

    def forget(self) -> None:
        """Discard a pick that waits for its counterpart."""
        self.picked_uv = self.picked_xyz = None

    def delete(self, number: int) -> None:
        """Delete a pair of the current frame.

        Raises InputError if the file cannot be written; the pairs are then unchanged.
        """
        kept = np.arange(len(self.pairs)) != number
        self._keep(PickedPairs(self.pairs.uv[kept], self.pairs.xyz[kept]))
        self.solve()

    def _add_pair(self) -> None:
        if self.picked_uv is not None and self.picked_xyz is not None:
            pairs = self.pairs
            self._keep(PickedPairs(np.vstack([pairs.uv, self.picked_uv]), np.vstack([pairs.xyz, self.picked_xyz])))
            self.forget()
            self.solve()

    def _keep(self, pairs: PickedPairs) -> None:
        """Replace the pairs of the current frame and write the file."""
        frames = {**self._pairs, self.name: pairs}
        write_pairs(self.path, {name: each for name, each in frames.items() if len(each)})
        self._pairs = frames

    # ---- the pose of all pairs

    def solve(self) -> None:
        """Estimate the pose from the pairs of all frames, None below MIN_SOLVED_PAIRS; raises as `solve_picks`."""
        self.solved = None
        if self.count >= MIN_SOLVED_PAIRS:
            picked = [number for number in range(len(self.names)) if len(self.pairs_of_frame(number))]
            self.solved = solve_picks(
                [PickedFrame(self.names[each], self._camera(each), self.pairs_of_frame(each)) for each in picked]
            )

    def residuals(self) -> Residuals:
        """Return the residuals of the pairs of the current frame."""
        pairs, solved = self.pairs, self.solved
        if solved is None or not len(pairs):
            return Residuals(np.full(len(pairs), np.nan), np.zeros(len(pairs), np.bool_), None)
        mine, pose = solved.frame_of == solved.frames.index(self.name), solved.camera_from_lidar
        projected = None if pose is None else self.camera.project(se3.apply(pose, pairs.xyz))
        return Residuals(solved.off_px[mine], solved.agrees[mine], projected)

    def _camera(self, number: int) -> Camera:
        """Return the camera of a frame, which is read at most once."""
        if number not in self._cameras:
            self._cameras[number] = self._dataset[self._indices[number]].camera
        return self._cameras[number]
