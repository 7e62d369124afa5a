"""The folder of `--out`: a result JSON, overlays and a convergence plot for each result, written as they come."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from p2o.errors import InputError
from p2o.files.file_names import folder_name
from p2o.files.whole_file import write_whole
from p2o.results.result import Status

if TYPE_CHECKING:
    from p2o.run.run import Progress, Run


@dataclass(frozen=True)
class OutDir:
    """DIR/run.json; for each frame DIR/FRAME/ with result.json, convergence.png, before.png and after.png.

    A joint result has its result.json and convergence.png in DIR itself.
    """

    root: Path

    @classmethod
    def prepared(cls, path: str) -> OutDir:
        """Return the folder, made if need be; InputError at once where it cannot be written, before any work."""
        root = Path(path)
        try:
            root.mkdir(parents=True, exist_ok=True)
            probe = root / f".p2o-{os.getpid()}"
            probe.write_bytes(b"")
            probe.unlink()
        except OSError as problem:
            raise _cannot_write(root, problem) from problem
        return cls(root)

    def write(self, progress: Progress) -> None:
        """Write everything about one finished result."""
        if progress.row is None:
            return
        joint = len(progress.row.result.frames) > 1
        home = self.root if joint else self.root / folder_name(progress.frames[0].name)
        try:
            _write_json(home / "result.json", progress.row.as_dict())
            _draw(self.root, home, progress)
        except OSError as problem:
            raise _cannot_write(home, problem) from problem

    def finish(self, run: Run) -> None:
        """Write the object of the whole run."""
        try:
            _write_json(self.root / "run.json", run.as_dict())
        except OSError as problem:
            raise _cannot_write(self.root, problem) from problem


def _cannot_write(path: Path, problem: OSError) -> InputError:
    return InputError(
        "cannot write the results",
        where=problem.filename or path,
        got=problem.strerror or str(problem),
        hint="free some space or choose another --out",
    )


def _write_json(path: Path, value: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode())


def _draw(root: Path, home: Path, progress: Progress) -> None:
    """Write the convergence plot, and before.png and after.png of every frame."""
    from p2o.draw import overlay, plots

    if progress.row is None:
        return
    result = progress.row.result
    plots.convergence(result, home / "convergence.png")
    for frame in progress.frames:
        folder = root / folder_name(frame.name)
        folder.mkdir(parents=True, exist_ok=True)
        twist = result.twist_of(frame.name)
        corrected = frame if twist is None else replace(frame, cloud=frame.cloud.untwisted(twist))
        for name, pose, camera, seen in (
            ("before", result.start, frame.camera, frame),
            ("after", result.camera_from_lidar, result.camera_of(frame.camera), corrected),
        ):
            view = None if result.status is Status.STAGE_FAILED else progress.assembly.view(seen)
            if view is not None and (len(view.image_edges) or len(view.cloud_edges)):
                view = view.as_seen_from(pose)
                picture = overlay.draw(frame.image.rgb, view.image_edges, view.cloud_edges, camera, pose)
            else:
                picture = overlay.draw_cloud(frame.image.rgb, seen.cloud, camera, pose)
            overlay.write_png(folder / f"{name}.png", picture)
