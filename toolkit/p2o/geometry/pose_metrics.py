"""The figures that publications report of many estimates, so that ours stand beside theirs.

"Rotation error" means four things in print: the angle of the rotation that is left, the norm of its three Euler angles,
their mean, and the error of one aggregate of all frames. Each is here under a name of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3

EULER = ("x", "y", "z")


def pose_metrics(
    estimates: Float, truths: Float, limits: Mapping[str, tuple[float, float]] | None = None
) -> dict[str, float]:
    """Return the figures of estimates (N, 4, 4) against truths (N, 4, 4), both camera_from_lidar; {} for none.

    What is left is R_est R_gt^T and t_est - t_gt, in the camera frame. In degrees and metres:
    `rotation_deg_*`, `translation_m_*` (mean, median, std, rmse) of the angle and the norm; `euler_deg_mean` and
    `shift_m_mean`, means over frames and axes of absolute Euler angles (turned about fixed x, y, z) and shifts, and
    `euler_deg_norm`, `shift_m_norm` the means of their norms; `*_x`, `*_y`, `*_z` by axis; `median_*` and `mode_*` the
    error of one extrinsic made of all frames, component by component. `limits` are named bounds (degrees, metres): the
    share of frames below both.
    """
    estimates, truths = np.asarray(estimates, np.float64), np.asarray(truths, np.float64)
    if not len(estimates):
        return {}
    euler, shift = left_over(estimates, truths)
    relative = estimates[:, :3, :3] @ truths[:, :3, :3].transpose(0, 2, 1)
    angle = np.array([se3.angle_deg(se3.make(turn, np.zeros(3))) for turn in relative])
    length = np.linalg.norm(shift, axis=1)
    out: dict[str, float] = {}
    for name, values in (("rotation_deg", angle), ("translation_m", length)):
        out |= {
            f"{name}_mean": float(values.mean()),
            f"{name}_median": float(np.median(values)),
            f"{name}_std": float(values.std()),
            f"{name}_rmse": float(np.sqrt((values**2).mean())),
        }
    for name, parts in (("euler_deg", euler), ("shift_m", shift)):
        out[f"{name}_mean"] = float(np.abs(parts).mean())
        out[f"{name}_norm"] = float(np.linalg.norm(parts, axis=1).mean())
        out |= {f"{name}_{axis}": float(np.abs(parts[:, i]).mean()) for i, axis in enumerate(EULER)}
    for name, centre in (("median", _median), ("mode", _mode)):
        out[f"{name}_rotation_deg"] = _angle_of(centre(euler))
        out[f"{name}_translation_m"] = float(np.linalg.norm(centre(shift)))
    for name, (most_deg, most_m) in (limits or {}).items():
        out[name] = float(((angle < most_deg) & (length < most_m)).mean())
    return out


def left_over(estimates: Float, truths: Float) -> tuple[Float, Float]:
    """Return Euler angles (N, 3) of R_est R_gt^T in degrees about fixed x, y, z, and t_est - t_gt (N, 3) in metres."""
    from scipy.spatial.transform import Rotation

    turns = estimates[:, :3, :3] @ truths[:, :3, :3].transpose(0, 2, 1)
    return Rotation.from_matrix(turns).as_euler("xyz", degrees=True), estimates[:, :3, 3] - truths[:, :3, 3]


def _angle_of(euler_deg: Float) -> float:
    from scipy.spatial.transform import Rotation

    return float(np.degrees(Rotation.from_euler("xyz", euler_deg, degrees=True).magnitude()))


def _median(values: Float) -> Float:
    return np.asarray(np.median(values, axis=0))


def _mode(values: Float) -> Float:
    return np.array([half_sample_mode(column) for column in values.T])


def half_sample_mode(values: Sequence[float] | Float) -> float:
    """Return where numbers lie densest: the shortest half of them, halved until two are left (Bickel 2002)."""
    found = np.sort(np.asarray(values, np.float64))
    while len(found) > 2:
        half = -(-len(found) // 2)
        widths = found[half - 1 :] - found[: len(found) - half + 1]
        start = int(np.argmin(widths))
        found = found[start : start + half]
    return float(found.mean())
