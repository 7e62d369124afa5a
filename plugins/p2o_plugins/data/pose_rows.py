"""Poses of which a table holds many: a quaternion and a translation a row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.arrays import Float

# As `p2o.geometry.pose_text` takes them.
_ROTATION_AT_ALL, _FARTHEST_M = 1e-2, 1e9


def pose_rows(xyzw: Any, translation_m: Any, where: Path, names: Sequence[object] | None = None) -> Float:
    """Return the poses (N, 4, 4) of quaternions x y z w (N, 4) and translations (N, 3) in metres.

    `names` say which row is meant in errors. Raises InputError for what is not finite, quaternions whose length is off
    1 by more than 0.01, and translations beyond all maps.
    """
    from scipy.spatial.transform import Rotation

    quaternions = np.asarray(xyzw, dtype=np.float64).reshape(-1, 4)
    translations = np.asarray(translation_m, dtype=np.float64).reshape(-1, 3)
    poses = np.tile(np.eye(4), (len(quaternions), 1, 1))
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(np.linalg.norm(quaternions, axis=1) - 1)
        wrong = ~(off < _ROTATION_AT_ALL) | ~(np.abs(translations) <= _FARTHEST_M).all(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        said = " ".join(f"{value:g}" for value in (*quaternions[row], *translations[row]))
        raise InputError(
            f"the pose of {names[row] if names is not None else f'row {row}'} is none",
            where=where,
            expected="a quaternion x y z w of length 1 and a translation in metres",
            got=said,
        )
    if len(quaternions):
        poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    poses[:, :3, 3] = translations
    return poses
