"""The file of `--rerun`: sweep, image, edges and poses of each frame as a recording of the Rerun viewer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from p2o.cli.out_dir import Drawn
from p2o.cli.summary import describe
from p2o.draw.overlay import CLOUD_NONE, COLOURS, IMAGE_NONE
from p2o.draw.sweep_image import sweep_colours
from p2o.errors import InputError
from p2o.features.side import SIDES
from p2o.files.input_file import expanded
from p2o.files.whole_file import make_writable, write_errors, write_whole
from p2o.frames.image import Image
from p2o.runtime.packages import optional_package

if TYPE_CHECKING:
    from p2o.arrays import Float, Int8
    from p2o.features.edges import ImageEdges
    from p2o.run.run import Progress

_IMAGE_NONE, _CLOUD_NONE = len(SIDES), len(SIDES) + 1
"""Classes of edges without a direction; those of the others are the numbers of their sides."""
_RADIUS_PX, _PLANE_M = -1.0, 1.0
"""Radius of points, which is negative for pixels of the screen, and distance of the image from its camera."""


@dataclass
class Recording:
    """A file of Rerun (.rrd), kept in memory until `finish`; `stream` is that of `rerun`, once there is a frame.

    The root `lidar` is the frame of the LiDAR: `lidar/sweep` coloured by range, `lidar/edges` by direction, and the
    cameras `lidar/before`, `lidar/after` and, if the truth is known, `lidar/truth`. Their transforms are
    camera_from_lidar. Each has `image`, without distortion because the viewer projects by a pinhole camera, and
    `image/edges`. The timeline `frame` counts the frames; `result` is the text of the result.
    """

    path: Path
    rerun: Any
    stream: Any = None
    _memory: Any = None
    _count: int = 0

    @classmethod
    def prepared(cls, path: str) -> Recording:
        """Create the folder of the file if needed.

        Raises MethodUnavailable if the package is not installed, InputError if the file cannot be written.
        """
        rerun = optional_package("rerun", "p2o run --rerun", '"rerun-sdk>=0.41"')
        file = expanded(path)
        if not path or file.is_dir():
            raise InputError("the recording is no file", where="--rerun", expected="FILE.rrd", got=path or "no name")
        with write_errors("the recording", file.parent):
            make_writable(file.parent)
        return cls(file, rerun)

    def write(self, progress: Progress) -> None:
        """Add the frames of one finished result."""
        if progress.row is None:
            return
        for frame in progress.frames:
            row, result = progress.row, progress.row.result
            after = Drawn.of(frame, result, result.camera_from_lidar)
            cameras = {"before": Drawn(frame, result.start, frame.camera, frame), "after": after}
            if row.truth is not None:
                cameras["truth"] = Drawn(frame, row.truth, frame.camera, frame)
            if self._count == 0:
                self.stream = self.rerun.RecordingStream("p2o")
                self._memory = self.stream.memory_recording()
                self._describe(cameras)
            self.stream.set_time("frame", sequence=self._count)
            text = f"{frame.name}\n\n```\n{describe(row)}\n```"
            self._log("result", "TextDocument", text, media_type="text/markdown")
            cloud, edges = after.seen.cloud, after.edges(progress)
            self._log("lidar/sweep", "Points3D", cloud.xyz, colors=sweep_colours(cloud), radii=_RADIUS_PX)
            xyz, side = (np.zeros((0, 3)), np.zeros(0, np.int8)) if edges is None else (edges[1].xyz, edges[1].side)
            self._log("lidar/edges", "Points3D", xyz, class_ids=_classes(side, _CLOUD_NONE), radii=2 * _RADIUS_PX)
            for name, camera in cameras.items():
                self._log_camera(f"lidar/{name}", camera, None if edges is None else edges[0])
            if row.truth is None:
                self._log("lidar/truth", "Clear", recursive=True)
            self._count += 1

    def finish(self) -> None:
        """Write the file if a frame was added; raises InputError if it cannot be written."""
        if self._count:
            write_whole(self.path, self._memory.drain_as_bytes())

    def _log(self, entity: str, archetype: str, *values: Any, static: bool = False, **components: Any) -> None:
        self.stream.log(entity, getattr(self.rerun, archetype)(*values, **components), static=static)

    def _describe(self, cameras: Mapping[str, Drawn]) -> None:
        """Log the axes, the colours of directions, and which views the viewer opens."""
        view = self.rerun.blueprint
        self.stream.log("lidar", self.rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        names = {side.value: (side.name.lower(), COLOURS[side.letter]) for side in SIDES}
        names |= {_IMAGE_NONE: ("image, no direction", IMAGE_NONE), _CLOUD_NONE: ("LiDAR, no direction", CLOUD_NONE)}
        self._log("/", "AnnotationContext", [(number, *about) for number, about in names.items()], static=True)
        shown = ["$origin/**", "/lidar/sweep", "/lidar/edges"]
        images = []
        for name, drawn in cameras.items():
            bounds = view.VisualBounds2D(x_range=(0, drawn.camera.width), y_range=(0, drawn.camera.height))
            place = f"/lidar/{name}/image"
            images.append(view.Spatial2DView(origin=place, contents=shown, name=name, visual_bounds=bounds))
        text = view.TextDocumentView(origin="/result", name="result")
        space = view.Vertical(view.Spatial3DView(origin="/lidar", name="LiDAR"), text, row_shares=[2, 1])
        self.stream.send_blueprint(view.Blueprint(view.Horizontal(space, view.Vertical(*images))))

    def _log_camera(self, entity: str, drawn: Drawn, edges: ImageEdges | None) -> None:
        """Log a camera at its pose with its image and the edges of the image."""
        image = Image(drawn.frame.image.rgb, drawn.camera).undistorted()
        pose, pinhole = drawn.pose, image.camera
        fx, fy, cx, cy = pinhole.params
        # Pixel centres of the viewer are at halves.
        matrix = np.array([[fx, 0, cx + 0.5], [0, fy, cy + 0.5], [0, 0, 1]])
        relation = self.rerun.TransformRelation.ChildFromParent
        self._log(entity, "Transform3D", translation=pose[:3, 3], mat3x3=pose[:3, :3], relation=relation)
        size = (pinhole.width, pinhole.height)
        axes = self.rerun.ViewCoordinates.RDF
        lens = {"image_from_camera": matrix, "resolution": size, "camera_xyz": axes, "image_plane_distance": _PLANE_M}
        self._log(f"{entity}/image", "Pinhole", **lens)
        self.stream.log(f"{entity}/image", self.rerun.Image(image.rgb).compress(jpeg_quality=90))
        uv, side = (np.zeros((0, 2)), np.zeros(0, np.int8)) if edges is None else (edges.uv, edges.side)
        if not drawn.camera.is_pinhole and len(uv):
            uv = pinhole.project(drawn.camera.rays(uv))
        ids = _classes(side, _IMAGE_NONE)
        self._log(f"{entity}/image/edges", "Points2D", _finite(uv) + 0.5, class_ids=ids, radii=2 * _RADIUS_PX)


def _classes(side: Int8, none: int) -> Any:
    """Return the class (N,) of edges of these sides; `none` is that of edges without a direction."""
    return np.where(side < 0, none, side).astype(np.uint16)


def _finite(uv: Float) -> Float:
    """Return pixels (N, 2), outside of every image where they are unknown."""
    return np.where(np.isfinite(uv), uv, -1e4)
