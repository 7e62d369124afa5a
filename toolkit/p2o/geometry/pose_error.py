"""How far a pose is from the truth, and summaries over many such errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3

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
    """Return means, medians and mean absolute per-axis errors, and how many are within `good_deg` and `good_m`."""
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
