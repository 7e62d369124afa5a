"""Numbers as text that YAML, XML, C++ and shells read back without loss."""

from __future__ import annotations

from typing import Any

import numpy as np


def quaternion_xyzw(transform: Any) -> list[float]:
    """Return the unit quaternion x y z w of a transform (4, 4), with w >= 0."""
    from scipy.spatial.transform import Rotation

    return plain(Rotation.from_matrix(transform[:3, :3]).as_quat(canonical=True))


def plain(values: Any) -> list[float]:
    """Return numbers as floats without negative zeros, which some command lines parse as options."""
    return [float(value) + 0.0 for value in np.asarray(values, dtype=np.float64).ravel()]


def digits(value: float) -> str:
    """Return a number with all its digits; the mantissa has a point, because YAML 1.1 reads 1e-17 as a string."""
    mantissa, e, exponent = repr(float(value) + 0.0).partition("e")
    return mantissa + (".0" if e and "." not in mantissa else "") + e + exponent


def spaced(values: Any) -> str:
    """Return numbers with all their digits, separated by blanks."""
    return " ".join(map(digits, plain(values)))


def listed(values: Any) -> str:
    """Return numbers with all their digits as a YAML list in one line."""
    return f"[{', '.join(map(digits, plain(values)))}]"


def matrix_rows(matrix: Any) -> list[list[float]]:
    """Return the rows of a matrix as lists."""
    return [plain(row) for row in matrix]
