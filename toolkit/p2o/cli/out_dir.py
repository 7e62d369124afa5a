"""The folder of `--out`: result JSON, overlays and a convergence plot of each result, written on completion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from p2o.draw.run_page import IN_ROOT, PAGE, RESULT, ROUNDS, RUN, run_page
from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.files.whole_file import make_writable, write_errors, write_json, write_whole
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.results.result import Status

if TYPE_CHECKING:
    from p2o.arrays import Float, UInt8
    from p2o.frames.frame import Frame
    from p2o.geometry.camera import Camera
    from p2o.results.result import Result
    from p2o.run.run import Progress, Run


_TIMES = ("before", "after")
_SWEEPS = tuple(f"sweep-{by}-{name}.png" for by in ("range", "reflectance") for name in _TIMES)
_CLOUD = "cloud.ply"


@dataclass(frozen=True)
class OutDir:
    """The output folder DIR with run.json, the page result.html, and a folder DIR/FRAME for each frame.

    A folder of a frame contains result.json, convergence.png, overlays (before.png, after.png), the sweep on the image
    (sweep-range-*.png and, with intensity, sweep-reflectance-*.png) and cloud.ply, the coloured sweep. The result.json
    and convergence.png of a joint result are in DIR, those of a camera of a rig in DIR/CAMERA. `folders` are by name.
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
        ours = (RESULT, ROUNDS, *(f"{name}.png" for name in _TIMES), *_SWEEPS, _CLOUD)
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
            self._draw(home, progress, progress.row.result)

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

    def _draw(self, home: Path, progress: Progress, result: Result) -> None:
        """Write the convergence plot, and the overlays and the coloured cloud of every frame."""
        from p2o.draw import overlay, plots

        plots.convergence(result, home / ROUNDS)
        for frame in progress.frames:
            folder = self.root / self.folders[frame.name]
            folder.mkdir(parents=True, exist_ok=True)
            twist = result.twist_of(frame.name)
            corrected = frame if twist is None else replace(frame, cloud=frame.cloud.untwisted(twist))
            if result.later_s and frame.twist is not None:
                corrected = replace(corrected, cloud=corrected.cloud.later(result.later_s, frame.twist))
            before = result.start, frame.camera, frame
            after = result.camera_from_lidar, result.camera_of(frame.camera), corrected
            _draw_sweeps(folder, frame.image.rgb, before, after)
            for name, (pose, camera, seen) in zip(_TIMES, (before, after), strict=True):
                view = None if result.status is Status.STAGE_FAILED else progress.assembly.view(seen)
                if view is not None and (len(view.image_edges) or len(view.cloud_edges)):
                    view = view.as_seen_from(pose)
                    small, camera = image_at_scale(frame.image).rgb, camera_at_scale(camera)
                    if small.shape[1::-1] != (camera.width, camera.height):
                        # A corrected focal length may cross the limit of downsampling.
                        camera = camera.resized(*small.shape[1::-1])
                    image = overlay.draw(small, view.image_edges, view.cloud_edges, camera, pose)
                else:
                    image = overlay.draw_cloud(frame.image.rgb, seen.cloud, camera, pose)
                overlay.write_png(folder / f"{name}.png", image)


def _draw_sweeps(
    folder: Path, rgb: UInt8, before: tuple[Float, Camera, Frame], after: tuple[Float, Camera, Frame]
) -> None:
    """Write the sweep on the image before and after, by range and by reflectance, and the coloured cloud."""
    from p2o.draw import coloured_cloud, overlay, sweep_image

    colourings: tuple[sweep_image.By, ...] = ("range", "reflectance")
    for by in colourings:
        for name, (pose, camera, frame) in zip(_TIMES, (before, after), strict=True):
            if by == "range" or frame.cloud.intensity is not None:
                image = sweep_image.draw_sweep(rgb, frame.cloud, camera, pose, by)
                overlay.write_png(folder / f"sweep-{by}-{name}.png", image)
    pose, camera, frame = after
    coloured_cloud.write_coloured_cloud(folder / _CLOUD, rgb, frame.cloud, camera, pose)


def _write_errors(folder: Path) -> AbstractContextManager[None]:
    return write_errors("the results", folder, "free some space or choose another --out")
