"""One training example: a picture with what is known about the occlusion orders of its pixels."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from p2o import Frame, InputError, image_at_scale, occlusion
from p2o.arrays import Int8, UInt8
from p2o.files.array_file import MAX_BYTES, read_npz
from p2o.files.input_file import read_bytes
from p2o.files.whole_file import write_whole

from p2o_plugins.p2ornet.spans import Spans, classes_of, depth_spans, lidar_spans

UNKNOWN = -1
"""The class of pairs of which nothing is known: they count nothing."""
DENSE = 0.9
"""From this share of known pixels on a depth map is dense, and the occlusion rule decides every pair."""
RAW_SPEED_M_S = 10.0
"""Assumed speed of a car whose sweeps tell the times of their points and were not corrected for ego-motion."""


@dataclass(frozen=True, eq=False)
class Example:
    """`rgb` (H, W, 3) uint8; `classes` (2, H, W) int8 of the east and south pairs, UNKNOWN where nothing is known.

    `spans` hold what is known of stretches of pairs only. `name` says where it comes from.
    """

    name: str
    rgb: UInt8
    classes: Int8 | None
    spans: Spans

    def save(self, path: Path) -> None:
        """Write the example as .npz without pickled objects."""
        write_whole(path, self.packed())

    def packed(self) -> bytes:
        """Return the content of the file that `save` writes."""
        classes = np.zeros((0, 0, 0), np.int8) if self.classes is None else self.classes
        file = io.BytesIO()
        np.savez(file, name=self.name, rgb=self.rgb, classes=classes, spans=self.spans.rows)
        return file.getvalue()

    @classmethod
    def load(cls, path: Path) -> Example:
        """Return an example that `save` wrote; raises InputError if the file is something else."""
        try:
            file = read_npz(read_bytes(path, "file of labels", MAX_BYTES), path)
            name, rgb, classes, rows = str(file["name"]), file["rgb"], file["classes"], file["spans"]
            if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
                raise ValueError(f"rgb {rgb.dtype} {rgb.shape}")
            if classes.dtype != np.int8 or (classes.size and classes.shape != (2, *rgb.shape[:2])):
                raise ValueError(f"classes {classes.dtype} {classes.shape}")
            if rows.dtype != Spans.joined().rows.dtype or rows.ndim != 1:
                raise ValueError(f"spans {rows.dtype} {rows.shape}")
            return cls(name, rgb, classes if classes.size else None, Spans(rows))
        except (ValueError, KeyError, InputError) as problem:
            got = problem.what if isinstance(problem, InputError) else problem
            raise InputError(
                "a file of labels cannot be read", where=path, expected="what p2o labels wrote", got=got
            ) from problem


def example_of(frame: Frame, *, foliage: str = "ignore") -> Example:
    """Return what a frame teaches.

    Dense depth (simulation, Virtual KITTI 2): the occlusion rule decides every pair; pairs whose hiding pixel is
    masked are unknown (`foliage` "ignore") or neither ("none", as in the paper). Otherwise: the sweep at the true
    extrinsic, and sparse depth where there is some. Pictures of long focal lengths are looked at as small as in a
    calibration. Raises InputError if the frame has neither.
    """
    image = image_at_scale(frame.image)
    depth = image.depth_m
    if depth is not None and np.mean(~np.isnan(depth)) > DENSE:
        orders = occlusion.occlusion_orders(depth, image.camera)
        classes = classes_of(np.stack([orders.east, orders.south]))
        if image.masked is not None:
            kept = occlusion.occlusion_orders(depth, image.camera, masked=image.masked)
            lost = classes != classes_of(np.stack([kept.east, kept.south]))
            classes[lost] = UNKNOWN if foliage == "ignore" else 1
        classes[0, :, -1] = UNKNOWN
        classes[1, -1] = UNKNOWN
        return Example(frame.name, image.rgb, classes, Spans.joined())
    parts = []
    if frame.camera_from_lidar is not None:
        # As in a calibration: points without times come from a sweep that was corrected, or was taken at rest.
        speed = RAW_SPEED_M_S if frame.cloud.time_s is not None and frame.twist is None else 0.0
        parts.append(lidar_spans(frame.cloud, image.camera, frame.camera_from_lidar, speed_m_s=speed))
    if depth is not None:
        parts.append(depth_spans(depth))
    if not parts:
        raise InputError(
            "the frame teaches nothing",
            where=frame.name,
            expected="a dense depth map, or a true extrinsic",
            got="neither",
        )
    return Example(frame.name, image.rgb, None, Spans.joined(*parts))
