"""The folder of `--out`: result JSON and overlays of each result, written on completion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.files.whole_file import make_writable, write_errors, write_json, write_whole
from p2o.frames.scale import image_at_scale
from p2o.page.run_page import IN_ROOT, PAGE, RESULT, RUN, run_page
from p2o.results.result import Status

if TYPE_CHECKING:
    from p2o.arrays import Float, UInt8
    from p2o.features.edges import CloudEdges, ImageEdges
    from p2o.frames.frame import Frame
    from p2o.geometry.camera import Camera
    from p2o.results.result import Result, RigResult
    from p2o.run.outcome import Run
    from p2o.run.run import Progress


_POSES = ("before", "after", "common")
_SWEEPS = tuple(f"sweep-{by}-{name}.png" for by in ("range", "reflectance") for name in _POSES)
_CLOUD = "cloud.ply"


@dataclass(frozen=True)
class OutDir:
    """The output folder DIR with run.json, the page result.html, and a folder DIR/FRAME for each frame.

    A folder of a frame contains result.json, overlays (before.png, after.png), the sweep on the image
    (sweep-range-*.png and, with intensity, sweep-reflectance-*.png) and cloud.ply, the coloured sweep. The result.json
    of a joint result is in DIR, that of a camera of a rig in DIR/CAMERA. Frames of a rig
    also have the overlays of the common result (common.png, sweep-range-common.png, ...). `folders` are by name.
    """

    root: Path
    folders: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def prepared(cls, path: str) -> OutDir:
        """Create the folder if needed; raises InputError if it cannot be written."""
        if not path:
            expected = "a folder, such as . for the current one"
            raise InputError("the folder has no name", where="--out", expected=expected)
        root = expanded(path)
        with _write_errors(root):
            make_writable(root)
        return cls(root)

    def for_frames(self, names: Sequence[str]) -> OutDir:
        """Return the output folder with distinct folders for all frames of a run."""
        from p2o.files.file_names import distinct_names

        return replace(self, folders=distinct_names(names, taken=IN_ROOT))

    @property
    def files(self) -> list[Path]:
        """The files to be written."""
        ours = (RESULT, *(f"{name}.png" for name in _POSES), *_SWEEPS, _CLOUD)
        own = [self.root / folder / name for folder in self.folders.values() for name in ours]
        return [*(self.root / name for name in IN_ROOT), *own]

    def write(self, progress: Progress) -> None:
        """Write the files of one finished result."""
        if progress.row is None:
            return
        joint = len(progress.row.result.frames) > 1 and not progress.camera
        home = self.root if joint else self.root / self.folders[progress.camera or progress.frames[0].name]
        with _write_errors(home):
            write_json(home / RESULT, progress.row.as_dict())
            self._draw(progress, progress.row.result)

    def write_common(self, calibrated: Sequence[Progress], rig: RigResult) -> None:
        """Write the overlays of the common result of a rig for the frames of its cameras, if it has a pose."""
        poses = {camera.name: camera.camera_from_lidar for camera in rig.cameras}
        for progress in calibrated:
            pose = poses.get(progress.camera)
            if progress.row is None or pose is None:
                continue
            for frame in progress.frames:
                folder = self.root / self.folders[frame.name]
                with _write_errors(folder):
                    Drawn.of(frame, progress.row.result, pose).write(folder, "common", progress)

    def finish(self, run: Run) -> Path | None:
        """Write run.json and the page, and return the page; None without finished results."""
        with _write_errors(self.root):
            content = run.as_dict()
            write_json(self.root / RUN, content)
            if run.rows:
                write_whole(self.root / PAGE, run_page(self.root, content, self.folders).encode())
        return self.root / PAGE if run.rows else None

    def content_text(self) -> str:
        """Return the content of the folder as text."""
        count = sum((self.root / name).is_dir() for name in self.folders.values())
        return f"{RUN} and {count} folder{'s' if count != 1 else ''} of images, clouds and results"

    def _draw(self, progress: Progress, result: Result) -> None:
        """Write the overlays and the coloured cloud of every frame."""
        for frame in progress.frames:
            folder = self.root / self.folders[frame.name]
            folder.mkdir(parents=True, exist_ok=True)
            after = Drawn.of(frame, result, result.camera_from_lidar)
            Drawn(frame, result.start, frame.camera, frame).write(folder, "before", progress)
            after.write(folder, "after", progress)
            after.write_cloud(folder)


@dataclass(frozen=True, eq=False)
class Drawn:
    """What is drawn of a frame: at a pose camera_from_lidar (4, 4), with the camera and the sweep of that pose.

    `seen` is the frame with the sweep compensated for the motions that the result reports.
    """

    frame: Frame
    pose: Float
    camera: Camera
    seen: Frame

    @classmethod
    def of(cls, frame: Frame, result: Result, pose: Float) -> Drawn:
        """Return a frame at a pose (4, 4), with the corrections of camera and sweep that its result reports."""
        twist = result.twist_of(frame.name)
        corrected = frame if twist is None else replace(frame, cloud=frame.cloud.untwisted(twist))
        if result.later_s and frame.twist is not None:
            corrected = replace(corrected, cloud=corrected.cloud.later(result.later_s, frame.twist))
        return cls(frame, pose, result.camera_of(frame.camera), corrected)

    def write(self, folder: Path, name: str, progress: Progress) -> None:
        """Write NAME.png, edges of both sensors, and sweep-*-NAME.png, the sweep by range and by reflectance."""
        from p2o.draw import overlay, sweep_image

        colourings: tuple[sweep_image.By, ...] = ("range", "reflectance")
        for by in colourings:
            if by == "range" or self.seen.cloud.intensity is not None:
                image = sweep_image.draw_sweep(self.frame.image.rgb, self.seen.cloud, self.camera, self.pose, by)
                overlay.write_png(folder / f"sweep-{by}-{name}.png", image)
        overlay.write_png(folder / f"{name}.png", self._overlay(progress))

    def write_cloud(self, folder: Path) -> None:
        """Write the coloured cloud."""
        from p2o.draw import coloured_cloud

        rgb, cloud = self.frame.image.rgb, self.seen.cloud
        coloured_cloud.write_coloured_cloud(folder / _CLOUD, rgb, cloud, self.camera, self.pose)

    def edges(self, progress: Progress) -> tuple[ImageEdges, CloudEdges] | None:
        """Return the edges of both sensors, those of the image in its full size; None if there are none."""
        assert progress.row is not None
        failed = progress.row.result.status is Status.STAGE_FAILED
        view = None if failed else progress.assembly.view(self.seen)
        if view is None or not (len(view.image_edges) or len(view.cloud_edges)):
            return None
        view = view.as_seen_from(self.pose)
        uv = (view.image_edges.uv + 0.5) * self._downsampling() - 0.5
        return replace(view.image_edges, uv=uv), view.cloud_edges

    def _downsampling(self) -> Float:
        """Return by how much (2,) the image that edges are extracted from is smaller, in each axis."""
        small, full = image_at_scale(self.frame.image).camera, self.frame.image.camera
        return np.array([full.width / small.width, full.height / small.height])

    def _overlay(self, progress: Progress) -> UInt8:
        """Return the overlay (H, W, 3) of the edges of both sensors, or of the sweep if there are none."""
        from p2o.draw import overlay

        rgb, edges = self.frame.image.rgb, self.edges(progress)
        if edges is None:
            return overlay.draw_cloud(rgb, self.seen.cloud, self.camera, self.pose)
        return overlay.draw(rgb, *edges, self.camera, self.pose, size=float(self._downsampling().mean()))


def _write_errors(folder: Path) -> AbstractContextManager[None]:
    return write_errors("the results", folder, "free some space or choose another --out")
