"""Parse poses of frame.yaml and rig files: a matrix, or a translation with one of four forms of rotation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.geometry import se3

_ROTATIONS = {"rotation_xyzw": (4,), "rotation": (3, 3), "rpy_deg": (3,), "rpy_rad": (3,)}
_FORMS = "3 or 4 rows of 4 numbers, or translation_m with one of rotation_xyzw, rotation (3x3), rpy_deg, rpy_rad"
_DIRECTIONS = ("camera_from_lidar", "lidar_from_camera")
# Error of a rotation that was rounded to three digits, and maximum error of a rotation.
_ROUNDED, _ROTATION_AT_ALL = 1e-3, 1e-2


def read_extrinsic(name: str, value: Any, where: Path) -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) and warnings of a pose as in `read_pose`, optionally with its direction.

    `{lidar_from_camera: POSE}` is inverted; `{camera_from_lidar: POSE}` is the default. Raises as `read_pose`.
    """
    forms = f"{_FORMS}; or either of them below the key {_DIRECTIONS[1]}, to be inverted"
    if isinstance(value, Mapping) and len(value) == 1 and (key := next(iter(value))) in _DIRECTIONS:
        pose, warnings = _read(f"{name}.{key}", value[key], where, _FORMS)
        return (se3.inverse(pose) if key == _DIRECTIONS[1] else pose), warnings
    return _read(name, value, where, forms)


def read_pose(name: str, value: Any, where: Path) -> tuple[Float, tuple[str, ...]]:
    """Return a pose of YAML or JSON as (4, 4), and warnings; `name` and `where` are used in errors.

    Accepted are 4x4 or 3x4 numbers, nested or flat, or a mapping of translation_m and one rotation: rotation_xyzw (a
    quaternion), rotation (3x3), rpy_deg or rpy_rad (about the fixed axes x, y, z: Rz Ry Rx, as in ROS). A rounded
    rotation is orthonormalised, with a warning if its error exceeds that of three digits. Raises InputError with the
    accepted forms for any other value and for a transform that is not rigid.
    """
    return _read(name, value, where, _FORMS)


def numbers(value: Any, *shapes: tuple[int, ...]) -> Float | None:
    """Return finite numbers of a file as an array of one of the shapes, nested or flat; None for any other value."""
    rows = value if isinstance(value, list | tuple) else ()
    nested = [isinstance(row, list | tuple) for row in rows]
    if all(nested) and len({len(row) for row in rows}) == 1:
        have: tuple[int, ...] = (len(rows), len(rows[0]))
        flat = [item for row in rows for item in row]
    else:
        have, flat = (len(rows),), list(rows)
    shape = next((s for s in shapes if have in (s, (int(np.prod(s)),))), None)
    if shape is None or any(not isinstance(item, int | float | str) or isinstance(item, bool) for item in flat):
        return None
    try:
        # YAML parses 1e-3 as a text.
        array = np.array([float(item) for item in flat], dtype=np.float64)
    except (ValueError, OverflowError):
        return None
    return array.reshape(shape) if np.isfinite(array).all() else None


def _read(name: str, value: Any, where: Path, forms: str) -> tuple[Float, tuple[str, ...]]:
    if not isinstance(value, Mapping):
        matrix = numbers(value, (4, 4), (3, 4))
        if matrix is None:
            raise _no_pose(name, value, where, forms)
        return _rigid(name, np.vstack([matrix, [0, 0, 0, 1]]) if len(matrix) == 3 else matrix, where)
    keys = ("translation_m", *_ROTATIONS)
    unknown = next((key for key in value if key not in keys), None)
    if unknown is not None:
        raise UnknownNameError(f"key of {name}", str(unknown), keys, where=where, hint=f"{name} is {forms}")
    given = [key for key in _ROTATIONS if key in value]
    if len(given) != 1 or "translation_m" not in value:
        raise _no_pose(name, value, where, forms)
    parts = {
        key: numbers(value[key], shape) for key, shape in ((given[0], _ROTATIONS[given[0]]), ("translation_m", (3,)))
    }
    for key, part in parts.items():
        if part is None:
            count = "3x3" if key == "rotation" else _ROTATIONS.get(key, (3,))[0]
            text = f"{name}.{key} is not valid"
            raise InputError(text, where=where, expected=f"{count} finite numbers", got=_short(value[key]))
    rotation, warnings = _rotation(name, given[0], parts[given[0]], where)
    pose, more = _rigid(name, se3.make(rotation, parts["translation_m"]), where)
    return pose, warnings + more


def _rotation(name: str, key: str, values: Any, where: Path) -> tuple[Float, tuple[str, ...]]:
    """Return the rotation (3, 3) of the numbers of a key, and warnings."""
    from scipy.spatial.transform import Rotation

    if key == "rotation":
        return values, ()
    if key == "rpy_rad" and (largest := float(np.abs(values).max())) > 2 * math.pi + _ROTATION_AT_ALL:
        text = f"an angle of {name} is more than a full turn"
        hint = "if the angles are in degrees, use rpy_deg, or multiply them by pi/180"
        raise InputError(text, where=where, expected="roll, pitch, yaw in radians", got=f"{largest:g} rad", hint=hint)
    if key != "rotation_xyzw":
        # Lower case means fixed (extrinsic) axes.
        return np.asarray(Rotation.from_euler("xyz", values, degrees=key == "rpy_deg").as_matrix()), ()
    length = math.hypot(*values)
    if not abs(length - 1) < _ROTATION_AT_ALL:
        text = f"the quaternion of {name} is not a rotation"
        expected = f"x y z w of length 1 within {_ROTATION_AT_ALL:g}"
        raise InputError(text, where=where, expected=expected, got=f"{length:g}")
    rotation = np.asarray(Rotation.from_quat(values).as_matrix())
    if abs(length - 1) < _ROUNDED:
        return rotation, ()
    return rotation, (f"{where}: the quaternion of {name} has length {length:.4f} and is normalised",)


def _rigid(name: str, matrix: Float, where: Path) -> tuple[Float, tuple[str, ...]]:
    pose = se3.check_rigid(name, matrix, where=where, tolerance=_ROTATION_AT_ALL)
    off = float(np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max())
    if off < _ROUNDED:
        return pose, ()
    return pose, (
        f"{where}: the rotation of {name} is orthonormal to {off:.1g} only and replaced by the nearest rotation",
    )


def _no_pose(name: str, value: Any, where: Path, forms: str) -> InputError:
    return InputError(f"{name} is not a pose", where=where, expected=forms, got=_short(value))


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
