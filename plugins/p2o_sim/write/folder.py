"""Write frames in the layout of the data set `folder`: one folder each with image.png, cloud.npz and frame.yaml."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Box, Checkerboard, Cloud, Frame, Sphere, Target

from p2o_sim.write.files import png, write_file


def write(frames: Iterable[Frame], root: Path) -> Iterator[str]:
    """Write frames below `root` one by one and yield the name with which `folder` reads each.

    Stored are both images, depth (float32 metres, with sky), the sweep (coordinates and intensity as float32) with
    rings and times, ground truth and initial guess, the camera's name, sequence, time and poses, and targets. A
    motion-compensated sweep is written raw, with the velocity with which the reader compensates it. The layout cannot
    store masked pixels.
    """
    import yaml

    for frame in frames:
        name = re.sub(r"[^A-Za-z0-9._-]+", "_", frame.name).strip("._") or "frame"
        folder, image, camera = root / name, frame.image, frame.camera
        size = {"width": camera.width, "height": camera.height}
        entry: dict[str, Any] = {"camera": {"model": camera.model, **size, "params": list(camera.params)}}
        entry |= {"image": "image.png", "cloud": "cloud.npz"}
        write_file(folder / "image.png", png(image.rgb))
        write_file(folder / "cloud.npz", _npz(frame.cloud))
        if image.right is not None:
            entry |= {"right": "right.png", "baseline_m": float(image.baseline_m or 0.0)}
            write_file(folder / "right.png", png(image.right))
        if image.depth_m is not None:
            entry["depth"] = "depth.npy"
            buffer = io.BytesIO()
            np.save(buffer, image.depth_m.astype(np.float32))
            write_file(folder / "depth.npy", buffer.getvalue())
        names = {"camera_name": frame.camera_name or None, "sequence": frame.sequence or None, "time_s": frame.time_s}
        entry |= {key: value for key, value in names.items() if value is not None}
        poses = {
            "truth": frame.camera_from_lidar,
            "start": frame.start,
            "lidar_world_from_lidar": frame.lidar_world_from_lidar,
            "camera_world_from_camera": frame.camera_world_from_camera,
        }
        entry |= {key: pose.tolist() for key, pose in poses.items() if pose is not None}
        if frame.targets:
            entry["targets"] = [_described(target) for target in frame.targets]
        if frame.cloud.time_s is not None:
            entry["image_time_s"] = 0.0
        if frame.cloud.twist is not None:
            entry["twist"] = frame.cloud.twist.tolist()
        # Written last, so that the reader ignores the folder of an interrupted frame.
        write_file(folder / "frame.yaml", yaml.safe_dump(entry, sort_keys=False, default_flow_style=None, width=120))
        yield name


def _described(target: Target) -> dict[str, Any]:
    """Return a target as a mapping of plain numbers."""
    if isinstance(target, Sphere):
        return {"kind": "sphere", "radius_m": float(target.radius_m)}
    size = {"width_m": float(target.width_m), "height_m": float(target.height_m)}
    if isinstance(target, Box):
        return {"kind": "box", **size, "depth_m": float(target.depth_m)}
    if isinstance(target, Checkerboard):
        pattern = {"columns": int(target.columns), "rows": int(target.rows), "square_m": float(target.square_m)}
        return {"kind": "checkerboard", **pattern, **size}
    return {"kind": "holes", **size, "holes": [list(hole) for hole in target.holes]}


def _npz(cloud: Cloud) -> bytes:
    arrays: dict[str, Any] = {"xyz": cloud.as_measured().astype(np.float32)}
    if cloud.ring is not None:
        arrays["ring"] = cloud.ring.astype(np.int32)
    if cloud.intensity is not None:
        arrays["intensity"] = cloud.intensity.astype(np.float32)
    if cloud.time_s is not None:
        arrays["time_s"] = cloud.time_s
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()
