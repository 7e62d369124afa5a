"""A pose as frame.yaml and rig files may tell it: rows of numbers, or one of four rotations beside a translation."""

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
_FORMS = "3 or 4 rows of 4 numbers, or translation_m beside one of rotation_xyzw, rotation (3x3), rpy_deg, rpy_rad"
_DIRECTIONS = ("camera_from_lidar", "lidar_from_camera")
# What is printed with three digits is off by less than the first, and no rotation that is meant by more than the other.
_ROUNDED, _ROTATION_AT_ALL = 1e-3, 1e-2


def read_extrinsic(name: str, value: Any, where: Path) -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) and warnings, of a pose as `read_pose` takes it or one that says its direction.

    `{lidar_from_camera: POSE}` is inverted; `{camera_from_lidar: POSE}` is what a pose means without.

    Raises InputError as `read_pose`.
    """
    forms = f"{_FORMS}; or either of them below the key {_DIRECTIONS[1]}, to be inverted"
    if isinstance(value, Mapping) and len(value) == 1 and (key := next(iter(value))) in _DIRECTIONS:
        pose, warnings = _read(f"{name}.{key}", value[key], where, _FORMS)
        return (se3.inverse(pose) if key == _DIRECTIONS[1] else pose), warnings
    return _read(name, value, where, forms)


def read_pose(name: str, value: Any, where: Path) -> tuple[Float, tuple[str, ...]]:
    """Return a pose of YAML or JSON as (4, 4), and warnings; `name` and `where` say in errors which it is.

    Taken are 4x4 or 3x4 numbers, nested or in a row, or a mapping of translation_m and one rotation: rotation_xyzw (a
    quaternion), rotation (3x3), rpy_deg or rpy_rad (about the fixed axes x, y, z: Rz Ry Rx, as in ROS). A rotation that
    was rounded is made one again, with a warning where it is off by more than three digits explain.

    Raises InputError that shows what is taken, for everything else and for what is no rigid transform.
    """
    return _read(name, value, where, _FORMS)


def numbers(value: Any, *shapes: tuple[int, ...]) -> Float | None:
    """Return finite numbers of a file as an array of one of the shapes, nested or in a row; None for anything else."""
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
        # YAML takes 1e-3 for a text.
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
    said = [key for key in _ROTATIONS if key in value]
    if len(said) != 1 or "translation_m" not in value:
        raise _no_pose(name, value, where, forms)
    parts = {
        key: numbers(value[key], shape) for key, shape in ((said[0], _ROTATIONS[said[0]]), ("translation_m", (3,)))
    }
    for key, part in parts.items():
        if part is None:
            count = "3x3" if key == "rotation" else _ROTATIONS.get(key, (3,))[0]
            raise InputError(
                f"{name}.{key} is not valid", where=where, expected=f"{count} finite numbers", got=_short(value[key])
            )
    rotation, warnings = _rotation(name, said[0], parts[said[0]], where)
    pose, more = _rigid(name, se3.make(rotation, parts["translation_m"]), where)
    return pose, warnings + more


def _rotation(name: str, key: str, values: Any, where: Path) -> tuple[Float, tuple[str, ...]]:
    """Return the rotation (3, 3) of the numbers of a key, and warnings."""
    from scipy.spatial.transform import Rotation

    if key == "rotation":
        return values, ()
    if key != "rotation_xyzw":
        # Lower case: axes that stay, not those that turn along.
        return np.asarray(Rotation.from_euler("xyz", values, degrees=key == "rpy_deg").as_matrix()), ()
    length = math.hypot(*values)
    if not abs(length - 1) < _ROTATION_AT_ALL:
        raise InputError(
            f"the quaternion of {name} is not a rotation",
            where=where,
            expected=f"x y z w of length 1 within {_ROTATION_AT_ALL:g}",
            got=f"{length:g}",
        )
    rotation = np.asarray(Rotation.from_quat(values).as_matrix())
    if abs(length - 1) < _ROUNDED:
        return rotation, ()
    return rotation, (f"{where}: the quaternion of {name} has length {length:.4f} and is brought to 1",)


def _rigid(name: str, matrix: Float, where: Path) -> tuple[Float, tuple[str, ...]]:
    pose = se3.check_rigid(name, matrix, where=where, tolerance=_ROTATION_AT_ALL)
    off = float(np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max())
    if off < _ROUNDED:
        return pose, ()
    return pose, (f"{where}: the rotation of {name} is orthonormal to {off:.1g} only, and the nearest one is taken",)


def _no_pose(name: str, value: Any, where: Path, forms: str) -> InputError:
    return InputError(f"{name} is no pose", where=where, expected=forms, got=_short(value))


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
