"""One form of calibration file as a value: its name, what it holds, and how it is told, read and written."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from p2o.errors import InputError
from p2o.formats.calibration import CAMERA, EXTRINSIC, Calibration
from p2o.formats.frame_names import FrameName
from p2o.formats.source import Source
from p2o.geometry import se3
from p2o.options import Options, field


class Reading(Options):
    """What may be said about a file that does not say it itself."""

    name: str = field("", max_length=200, help="Which camera of a file that holds several: cam1, P2, an id.")
    lidar_frame: FrameName | None = field(None, help="Name of the LiDAR's frame in the file.")
    camera_frame: FrameName | None = field(None, help="Name of the camera's frame in the file.")
    direction: Literal["camera_from_lidar", "lidar_from_camera"] | None = field(
        None, help="Which way a bare matrix goes; default: what the file says, else camera_from_lidar."
    )
    width: int | None = field(None, gt=0, le=30_000, help="Image width in pixels, where the file does not say it.")
    height: int | None = field(None, gt=0, le=30_000, help="Image height in pixels, where the file does not say it.")


@dataclass(frozen=True, kw_only=True)
class Format:
    """One form of file.

    `holds` says what it has room for and `needs` what it is nothing without (`PARTS`); `direction` is the transform
    that its numbers are. `recognises` tells files of the form by their content alone, `read` reads them. `write` is
    None for forms that are read only; it takes a calibration and `options`.
    """

    name: str
    summary: str
    holds: frozenset[str]
    direction: str
    suffix: str
    recognises: Callable[[Source], bool]
    read: Callable[[Source, Reading], Calibration]
    options: type[Options] = Options
    write: Callable[[Calibration, Any], bytes] | None = None
    needs: frozenset[str] = frozenset()

    def written(self, calibration: Calibration, options: Options | None = None, where: object = None) -> bytes:
        """Return the bytes of a file that holds the calibration, as far as the form has room.

        Raises InputError for a form that is read only, for what the form needs and the calibration lacks, and for a
        camera that the form has no name for.
        """
        if self.write is None:
            raise InputError(f"{self.name} is read, not written", where=where, expected="another form")
        lacking = sorted(self.needs - calibration.held) or (
            [] if self.holds & calibration.held else [" or ".join(sorted(self.holds))]
        )
        if lacking:
            raise InputError(
                f"{self.name} holds {' and '.join(sorted(self.needs or self.holds))}, and there is no {lacking[0]}",
                where=where,
                expected=f"a {lacking[0]}",
                hint="give the file of the camera too (--camera FILE)" if lacking == [CAMERA] else None,
            )
        return self.write(calibration, options or self.options())


BOTH = frozenset({CAMERA, EXTRINSIC})
ONLY_CAMERA = frozenset({CAMERA})
ONLY_EXTRINSIC = frozenset({EXTRINSIC})


def size_of(width: Any, height: Any, reading: Reading, where: object) -> tuple[int, int]:
    """Return the image size that a file or else the reading states; raises InputError where neither does."""
    said = (reading.width if width is None else width, reading.height if height is None else height)
    if None in said:
        raise InputError(
            "the file does not say the size of the image",
            where=where,
            expected="width and height in px",
            hint="say it: FILE?width=W&height=H",
        )
    sizes = []
    for value in said:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value % 1:
            raise InputError("the size of the image is no number", where=where, expected="px", got=repr(value)[:60])
        sizes.append(int(value))
    return sizes[0], sizes[1]


def quaternion_xyzw(transform: Any) -> list[float]:
    """Return the unit quaternion x y z w of a transform (4, 4), w not negative."""
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(transform[:3, :3]).as_quat(canonical=True)
    return plain(found)


def plain(values: Any) -> list[float]:
    """Return numbers as floats without negative zeros, which some readers take for options."""
    return [float(value) + 0.0 for value in np.asarray(values, dtype=np.float64).ravel()]


def digits(value: float) -> str:
    """Return a number with all its digits, as YAML 1.1, shells, XML and C++ read it: 1e-17 is a text in YAML."""
    mantissa, e, exponent = repr(float(value) + 0.0).partition("e")
    return mantissa + (".0" if e and "." not in mantissa else "") + e + exponent


def spaced(values: Any) -> str:
    """Return numbers with all their digits, separated by blanks."""
    return " ".join(map(digits, plain(values)))


def listed(values: Any) -> str:
    """Return numbers with all their digits as a list of YAML in one line."""
    return f"[{', '.join(map(digits, plain(values)))}]"


def matrix_rows(matrix: Any) -> list[list[float]]:
    """Return the rows of a matrix as lists."""
    return [plain(row) for row in matrix]


def both_ways(camera_from_lidar: Any, parent_is_lidar: bool) -> Any:
    """Return parent_from_child (4, 4) of camera_from_lidar."""
    return se3.inverse(camera_from_lidar) if parent_is_lidar else np.asarray(camera_from_lidar)
