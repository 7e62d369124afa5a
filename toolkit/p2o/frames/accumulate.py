"""Accumulate sweeps of a sequence into one dense cloud in the LiDAR frame of a reference frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from p2o.arrays import Float, Int
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.geometry import se3

Direction = Literal["past", "future", "both"]


def nearest_in_time(times_s: Float, time_s: float, sweeps: int, direction: Direction = "both") -> Int:
    """Return the indices of the up to `sweeps` times (N,) nearest to `time_s`, in order of time; never `time_s` itself.

    Of two times at equal distance, the earlier one comes first.
    """
    times_s = np.asarray(times_s, dtype=np.float64)
    gap_s = times_s - time_s
    allowed = {"past": gap_s < 0, "future": gap_s > 0, "both": gap_s != 0}[direction]
    candidates = np.flatnonzero(allowed)
    order = np.lexsort((times_s[candidates], np.abs(gap_s[candidates])))
    chosen = candidates[order[: max(sweeps, 0)]]
    return np.asarray(chosen[np.argsort(times_s[chosen], kind="stable")], dtype=np.int64)


def neighbours(
    reference: Frame, frames: Iterable[Frame], *, sweeps: int, direction: Direction = "both"
) -> tuple[Frame, ...]:
    """Return the up to `sweeps` frames of the reference's sequence nearest to it in time, in order of time.

    Frames of other sequences or cameras (which have the same sweeps), frames without a time and the reference are left
    out. Raises InputError if the reference has no sequence or no time.
    """
    if not reference.sequence or reference.time_s is None:
        missing = "sequence" if not reference.sequence else "time"
        raise InputError(f"the frame has no {missing}, hence no neighbouring frames", where=reference.name)
    drive = (reference.sequence, reference.camera_name)
    same = [f for f in frames if (f.sequence, f.camera_name) == drive and f.name != reference.name]
    timed = [(frame, frame.time_s) for frame in same if frame.time_s is not None]
    chosen = nearest_in_time(np.array([time_s for _, time_s in timed]), reference.time_s, sweeps, direction)
    return tuple(timed[index][0] for index in chosen)


def accumulated(
    reference: Frame, others: Iterable[Frame], *, voxel_m: float | None = None, max_range_m: float | None = None
) -> Cloud:
    """Return the sweeps of the reference and of other frames of its sequence as one cloud.

    The cloud is in the LiDAR frame of the reference at its time 0, with the reference's sweep first. Each sweep is
    motion-compensated to time 0 of its frame if its velocity is known, then transformed by lidar_from_world of the
    reference @ world_from_lidar of the other. Intensity is kept if all sweeps have it; rings, columns and times are
    dropped. Points beyond `max_range_m` from the reference's LiDAR are left out, and of the points in a voxel of
    `voxel_m` only the one nearest to its centre is kept. The reference is used once, also if it is among `others`.
    Raises InputError for frames of other sequences or none, frames without a LiDAR pose, and if no point is left.
    """
    frames = [reference, *(frame for frame in others if frame.name != reference.name)]
    if len(frames) > 1:
        _require_one_sequence(frames)
    # At time 0 of their frame; sweeps of unknown velocity are unchanged.
    points = [f.cloud.xyz if f.twist is None else f.cloud.untwisted(f.twist).xyz for f in frames]
    parts = [(f.cloud, xyz, _reference_from(reference, f)) for f, xyz in zip(frames, points, strict=True)]
    xyz = np.concatenate([se3.apply(moved, points) for _, points, moved in parts])
    intensities = [cloud.intensity for cloud, _, _ in parts if cloud.intensity is not None]
    cloud = Cloud(xyz, intensity=np.concatenate(intensities) if len(intensities) == len(parts) else None)
    if max_range_m is not None:
        near = np.linalg.norm(cloud.xyz, axis=1) <= max_range_m
        if not near.any():
            text = "no point is within the range limit"
            raise InputError(text, where=reference.name, expected=f"within {max_range_m:g} m")
        cloud = cloud.select(near)
    return cloud if voxel_m is None else cloud.select(one_per_voxel(cloud.xyz, voxel_m))


def one_per_voxel(xyz: Float, voxel_m: float) -> Int:
    """Return the ascending indices of one point per voxel of side `voxel_m`: the one nearest to its centre.

    Voxels have corners at the origin; of points (N, 3) at equal distance, the first is kept. Raises InputError for a
    side that is not positive.
    """
    if not voxel_m > 0:
        raise InputError("the voxel size is not positive", expected="metres > 0", got=voxel_m)
    cell = np.floor(xyz / voxel_m)
    off_centre = ((xyz / voxel_m - cell - 0.5) ** 2).sum(axis=1)
    order = np.lexsort((off_centre, cell[:, 2], cell[:, 1], cell[:, 0]))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(cell[order], axis=0) != 0).any(axis=1)
    return np.asarray(np.sort(order[first]), dtype=np.int64)


def _reference_from(reference: Frame, frame: Frame) -> Float:
    """Return reference_from_lidar (4, 4) of a frame."""
    if frame is reference or reference.lidar_world_from_lidar is None or frame.lidar_world_from_lidar is None:
        return np.eye(4)
    return se3.inverse(reference.lidar_world_from_lidar) @ frame.lidar_world_from_lidar


def _require_one_sequence(frames: Sequence[Frame]) -> None:
    reference = frames[0]
    for frame in frames:
        if not frame.sequence or frame.sequence != reference.sequence:
            text = "sweeps of different sequences have no common world frame"
            expected = f"sequence '{reference.sequence}'" if reference.sequence else "frames of one sequence"
            got = f"'{frame.sequence}'" if frame.sequence else "none"
            raise InputError(text, where=frame.name, expected=expected, got=got)
        if frame.lidar_world_from_lidar is None:
            text = "the frame has no LiDAR pose, hence its sweep cannot be transformed"
            hint = "--accumulate gicp, or p2o.frames.lidar_odometry, estimates poses from the sweeps"
            raise InputError(text, where=frame.name, expected="lidar_world_from_lidar", hint=hint)
