"""The error of a pose against the ground truth, summaries of errors, and error metrics of publications."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3

SAME_POSE_DEG, SAME_POSE_M = 0.5, 0.3
"""Minima of a search with a smaller difference are the same."""
AXES = ("roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m")


@dataclass(frozen=True)
class PoseError:
    """The error of one estimate (docs/conventions.md).

    `rotation_deg` is the angle of R_gt^T R and `translation_m` the norm of the translation of T_gt^-1 T. `per_axis`
    holds the signed parts about and along the camera axes: roll about z (forward), pitch about x (right), yaw about y
    (down), and x, y, z.
    """

    rotation_deg: float
    translation_m: float
    per_axis: Mapping[str, float]


def is_distinct(b_from_a: Float) -> bool:
    """Return whether two poses with this difference (4, 4) are distinct minima of a search."""
    return se3.angle_deg(b_from_a) > SAME_POSE_DEG or se3.distance_m(b_from_a) > SAME_POSE_M


def pose_error(estimate: Float, truth: Float) -> PoseError:
    """Return the error of camera_from_lidar `estimate` against `truth`, both (4, 4)."""
    relative = se3.inverse(truth) @ estimate
    to_camera = truth[:3, :3]
    pitch, yaw, roll = np.degrees(to_camera @ se3.rotation_vector(relative[:3, :3]))
    x, y, z = to_camera @ relative[:3, 3]
    values = (roll, pitch, yaw, x, y, z)
    per_axis = dict(zip(AXES, (float(v) for v in values), strict=True))
    return PoseError(se3.angle_deg(relative), se3.distance_m(relative), per_axis)


def summarise(errors: Sequence[PoseError], good_deg: float = 0.3, good_m: float = 0.10) -> dict[str, float | int]:
    """Return means, medians and mean absolute per-axis errors, and the number within `good_deg` and `good_m`."""
    if not errors:
        return {"count": 0}
    rotation = np.array([e.rotation_deg for e in errors])
    translation = np.array([e.translation_m for e in errors])
    out: dict[str, float | int] = {
        "count": len(errors),
        "rotation_deg_mean": float(rotation.mean()),
        "rotation_deg_median": float(np.median(rotation)),
        "translation_m_mean": float(translation.mean()),
        "translation_m_median": float(np.median(translation)),
        f"within_{good_deg:g}deg_{good_m:g}m": int(((rotation <= good_deg) & (translation <= good_m)).sum()),
    }
    for axis in AXES:
        out[f"{axis}_mean_abs"] = float(np.mean([abs(e.per_axis[axis]) for e in errors]))
    return out


EULER = ("x", "y", "z")


def pose_metrics(
    estimates: Float, truths: Float, limits: Mapping[str, tuple[float, float]] | None = None
) -> dict[str, float]:
    """Return the metrics of estimates (N, 4, 4) against truths (N, 4, 4), both camera_from_lidar; {} for N = 0.

    Residuals are R_est R_gt^T and t_est - t_gt, in the camera frame, in degrees and metres: `rotation_deg_*`,
    `translation_m_*` (mean, median, std, rmse) of angle and norm; `euler_deg_mean` and `shift_m_mean`, means over
    frames and axes of absolute Euler angles (about the fixed axes x, y, z) and translations, and `euler_deg_norm`,
    `shift_m_norm` the means of their norms; `*_x`, `*_y`, `*_z` by axis; `median_*` and `mode_*` the error of one
    extrinsic aggregated component by component over all frames. `limits` are named bounds (degrees, metres), whose
    metric is the share of frames below both.
    """
    from scipy.spatial.transform import Rotation

    estimates, truths = np.asarray(estimates, np.float64), np.asarray(truths, np.float64)
    if not len(estimates):
        return {}
    relative = estimates[:, :3, :3] @ truths[:, :3, :3].transpose(0, 2, 1)
    euler = Rotation.from_matrix(relative).as_euler("xyz", degrees=True)
    shift = estimates[:, :3, 3] - truths[:, :3, 3]
    angle = np.array([se3.angle_deg(se3.make(turn, np.zeros(3))) for turn in relative])
    length = np.linalg.norm(shift, axis=1)
    out: dict[str, float] = {}
    for name, values in (("rotation_deg", angle), ("translation_m", length)):
        out |= {f"{name}_mean": float(values.mean()), f"{name}_median": float(np.median(values))}
        out |= {f"{name}_std": float(values.std()), f"{name}_rmse": float(np.sqrt((values**2).mean()))}
    for name, parts in (("euler_deg", euler), ("shift_m", shift)):
        out[f"{name}_mean"] = float(np.abs(parts).mean())
        out[f"{name}_norm"] = float(np.linalg.norm(parts, axis=1).mean())
        out |= {f"{name}_{axis}": float(np.abs(parts[:, i]).mean()) for i, axis in enumerate(EULER)}
    centres = {"median": (np.median(euler, axis=0), np.median(shift, axis=0)), "mode": (_mode(euler), _mode(shift))}
    for name, (turn, step) in centres.items():
        out[f"{name}_rotation_deg"] = float(np.degrees(Rotation.from_euler("xyz", turn, degrees=True).magnitude()))
        out[f"{name}_translation_m"] = float(np.linalg.norm(step))
    for name, (most_deg, most_m) in (limits or {}).items():
        out[name] = float(((angle < most_deg) & (length < most_m)).mean())
    return out


def _mode(values: Float) -> Float:
    return np.array([half_sample_mode(column) for column in values.T])


def half_sample_mode(values: Sequence[float] | Float) -> float:
    """Return the half-sample mode: the shortest half of the values, halved until two are left (Bickel 2002)."""
    densest = np.sort(np.asarray(values, np.float64))
    while len(densest) > 2:
        half = -(-len(densest) // 2)
        widths = densest[half - 1 :] - densest[: len(densest) - half + 1]
        start = int(np.argmin(widths))
        densest = densest[start : start + half]
    return float(densest.mean())


def deviations(covariance: Float, camera_from_lidar: Float) -> tuple[float, float]:
    """Return the RMS errors in deg and m of a covariance (6, 6) of a left update in rad and m.

    A rotation w about the camera translates the LiDAR at t by w x t, which is part of the translation error
    (`p2o.pose_error`).
    """
    by_update = place_by_update(camera_from_lidar)
    variances = np.diag(by_update @ covariance @ by_update.T)
    return float(np.degrees(np.sqrt(variances[:3].sum()))), float(np.sqrt(variances[3:].sum()))


def place_by_update(camera_from_lidar: Float) -> Float:
    """Return the derivative (6, 6) of orientation and position of the LiDAR in the camera frame by a left update."""
    by_update = np.eye(6)
    by_update[3:, :3] = -se3.skew(camera_from_lidar[:3, 3])
    return by_update
