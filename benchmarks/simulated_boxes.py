"""Boxes of the simulator's cars and people, for `atop`: `python benchmarks/simulated_boxes.py OUT "scenes=4"`.

Rectangles are those of an object's visible pixels, cuboids those of its whole mesh, in a file a frame
(`object_boxes`). Neither sensor's box knows of the other: only kinds are written, not which belong together.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.files.file_names import folder_name
from p2o.geometry.motion import pose_at
from p2o_sim import Class

_KINDS = (Class.CAR, Class.VAN, Class.TRUCK, Class.BUS, Class.PERSON, Class.CYCLIST)
_LEAST_PX = 80  # objects of which fewer pixels are seen have no rectangle
_FARTHEST_M = 60.0  # and more distant ones show no cuboid


def boxes_of(view: Any) -> dict[str, Any]:
    """Return what a file of boxes holds (`object_boxes.BoxFile`) of a frame of the simulator."""
    scene, picture = view.scene, view.rendered
    lidar_from_world = p2o.se3.inverse(view.moment.world_from_lidar)
    points: dict[int, list[Float]] = {}
    kinds: dict[int, Class] = {}
    still = [(part, np.eye(4)) for part in scene.parts]
    moving = [(part, pose_at(mover.twist, view.moment.time_s)) for mover in scene.movers for part in mover.parts]
    for part, moved in still + moving:
        if part.kind in _KINDS:
            points.setdefault(part.thing, []).append(p2o.se3.apply(lidar_from_world @ moved, part.mesh.vertices))
            kinds[part.thing] = part.kind
    cuboids, boxes = [], []
    for thing, clouds in points.items():
        kind, xyz = kinds[thing].name.lower(), np.concatenate(clouds)
        rows, columns = np.nonzero(picture.instance == thing + 1)
        if len(rows) >= _LEAST_PX:
            edges = (columns.min(), rows.min(), columns.max(), rows.max())
            boxes.append({"kind": kind, "uv": [float(edge) for edge in edges]})
        if np.linalg.norm(xyz.mean(axis=0)) < _FARTHEST_M:
            cuboids.append({"kind": kind, **_around(xyz)})
    return {"boxes": boxes, "cuboids": cuboids}


def _around(xyz: Float) -> dict[str, Any]:
    """Return centre, size and yaw of the smallest upright cuboid around points (N, 3)."""
    import cv2

    (x, y), (length, width), yaw_deg = cv2.minAreaRect(xyz[:, :2].astype(np.float32))
    low, high = xyz[:, 2].min(), xyz[:, 2].max()
    size = [max(float(side), 0.01) for side in (length, width, high - low)]
    return {"centre": [float(x), float(y), float((low + high) / 2)], "size": size, "yaw_deg": float(yaw_deg)}


def write_boxes(folder: Path, options: Any) -> list[Path]:
    """Write the boxes of all frames of the simulator's options; return the files."""
    from p2o_sim import synthetic

    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for scene in range(options.scenes):
        for number in range(options.frames_per_scene):
            view = synthetic.view(options, scene, number)
            files.append(folder / f"{folder_name(view.frame.name)}.json")
            files[-1].write_text(json.dumps(boxes_of(view)), encoding="utf-8")
    return files


def _options(words: str) -> Any:
    from p2o_sim.synthetic import SyntheticOptions

    pairs = (word.partition("=") for word in words.split("&") if word)
    return SyntheticOptions.model_validate({name: value for name, _, value in pairs}, strict=False)


if __name__ == "__main__":
    for file in write_boxes(Path(sys.argv[1]), _options(sys.argv[2] if len(sys.argv) > 2 else "")):
        print(file)
