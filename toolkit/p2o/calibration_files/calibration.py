"""The content of a calibration file, its bytes decoded once for all readers, and the protocol of readers of formats."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import read_bytes
from p2o.files.parsed_text import parse_json, parse_yaml
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.options import Options, field

CAMERA, EXTRINSIC = "camera", "extrinsic"
PARTS = (CAMERA, EXTRINSIC)
"""The parts that a calibration file may hold."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera, camera_from_lidar (4, 4) in metres, or both; None for what the file does not hold.

    Camera axes are x right, y down, z forward. `lidar_frame` and `camera_frame` are the frame names in the file, or
    empty. `remarks` are warnings about the file in sentences. `lacks_image_size` states that the file holds a camera
    without the size of its image, which is therefore left out. `comment` is one line about the origin, which formats
    with comments write. `quaternion` states that the file holds the rotation as a quaternion. Raises InputError for a
    transform that is not rigid.
    """

    camera: Camera | None = None
    camera_from_lidar: Float | None = None
    lidar_frame: str = ""
    camera_frame: str = ""
    remarks: tuple[str, ...] = ()
    lacks_image_size: bool = False
    comment: str = ""
    quaternion: bool = False

    def __post_init__(self) -> None:
        if self.camera_from_lidar is not None:
            pose = se3.check_rigid("camera_from_lidar", self.camera_from_lidar)
            # Keep the given numbers instead of the nearest rotation, so that conversions are exact to the last bit.
            given = np.array(self.camera_from_lidar, dtype=np.float64)
            exact = np.abs(given - pose).max() < 1e-12
            given.flags.writeable = False
            object.__setattr__(self, "camera_from_lidar", given if exact else pose)

    @property
    def parts(self) -> frozenset[str]:
        """The parts in `PARTS` that the file contains."""
        values = {CAMERA: self.camera, EXTRINSIC: self.camera_from_lidar}
        return frozenset(part for part, value in values.items() if value is not None)

    def extrinsic(self, where: object = None) -> Float:
        """Return camera_from_lidar (4, 4); raises InputError if there is none."""
        if self.camera_from_lidar is None:
            raise InputError("the file has no extrinsic", where=where, expected="a transform of camera and LiDAR")
        return self.camera_from_lidar

    def intrinsics(self, where: object = None) -> Camera:
        """Return the camera; raises InputError if there is none."""
        if self.camera is None and self.lacks_image_size:
            expected, hint = "intrinsics and the size of the image", "give the size: FILE?width=W&height=H"
            raise InputError("there is no camera in it", where=where, expected=expected, hint=hint)
        if self.camera is None:
            raise InputError("the file has no camera", where=where, expected="intrinsics of a camera")
        return self.camera


_WHAT = "calibration file"
_MOST_BYTES = 16 << 20
"""Limit on the size: results with many rounds are the largest calibration files, all others take a few pages."""
_OPENCV_HEAD = re.compile(r"\A\ufeff?%YAML:1\.0[^\n]*\n")


@dataclass(frozen=True)
class Source:
    """The bytes of a file and its path; text, JSON and YAML are parsed on first use."""

    path: Path
    data: bytes

    @classmethod
    def of(cls, path: Path) -> Source:
        """Read a file; raises InputError as `read_bytes`, and for a file above 16 MiB."""
        return cls(path, read_bytes(path, _WHAT, _MOST_BYTES))

    @cached_property
    def text(self) -> str:
        """The file as UTF-8 text, empty for other bytes."""
        try:
            return self.data.decode("utf-8").removeprefix("\ufeff").replace("\r\n", "\n")
        except UnicodeDecodeError:
            return ""

    @cached_property
    def lines(self) -> list[str]:
        """The lines that are neither blank nor comments (#)."""
        return [line for line in self.text.splitlines() if line.strip() and not line.lstrip().startswith("#")]

    @cached_property
    def is_opencv(self) -> bool:
        """Whether the file is YAML of cv::FileStorage."""
        return bool(_OPENCV_HEAD.match(self.text)) or "!!opencv-matrix" in self.text[:100_000]

    @cached_property
    def _parsed(self) -> tuple[Any, InputError | None]:
        """The value of the file as JSON or YAML, and the parser's error if there is none."""
        text = self.text.strip()
        try:
            if text.startswith(("{", "[")) and self.path.suffix.lower() not in (".yaml", ".yml"):
                return parse_json(text, _WHAT, self.path), None
            if not text or text.startswith("<"):
                return None, None
            if self.is_opencv:
                # Its directive is not valid YAML, and its tags repeat what the keys below them state.
                text = _OPENCV_HEAD.sub("", text).replace("!!opencv-matrix", "").removeprefix("---")
            # `ros2 topic echo` ends a message with ---.
            return parse_yaml(text.removesuffix("---"), _WHAT, self.path), None
        except InputError as problem:
            return None, problem

    @property
    def value(self) -> Any:
        """The value of the file as JSON or YAML, or None."""
        return self._parsed[0]

    @property
    def problem(self) -> InputError | None:
        """The error of the JSON or YAML parser, or None."""
        return self._parsed[1]

    @property
    def tree(self) -> dict[str, Any]:
        """The mapping at the top level of JSON or YAML, empty for any other content."""
        value = self.value
        return value if isinstance(value, dict) else {}


FrameName = Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_/.-]*$")]
"""A frame name that shells, XML, YAML and Python accept without quoting."""

DEFAULT_RANK = 50


class Reading(Options):
    """Facts that a calibration file may leave out; users state them as FILE#NAME or FILE?FIELD=VALUE.

    A reader may derive its own options from this class.
    """

    name: str = field("", max_length=200, help="Which camera of a file that holds several: cam1, P2, an id.")
    lidar_frame: FrameName | None = field(None, help="Name of the LiDAR frame in the file.")
    camera_frame: FrameName | None = field(None, help="Name of the camera frame in the file.")
    direction: Literal["camera_from_lidar", "lidar_from_camera"] | None = field(
        None, help="Direction of a bare matrix; default: as stated in the file, else camera_from_lidar."
    )
    width: int | None = field(None, gt=0, le=30_000, help="Image width in pixels, if the file does not state it.")
    height: int | None = field(None, gt=0, le=30_000, help="Image height in pixels, if the file does not state it.")
    camera_axes: Literal["optical", "body"] | None = field(
        None, help="Axes of the camera frame: z forward (optical) or x forward (body); default: by its name."
    )


class CalibrationReader(ABC):
    """Reads the files of one format, with the options it was built with.

    `rank` orders recognition: the readers of a low rank are asked first. A format with a signature of its own has a
    rank below 50, a generic one, which files of other formats may satisfy as well, a rank above.
    """

    rank: int = DEFAULT_RANK

    @abstractmethod
    def recognises(self, source: Source) -> bool:
        """Return whether a file has this format, judged by its content alone; must not raise for any content."""

    @abstractmethod
    def read(self, source: Source) -> Calibration:
        """Return the content of a file.

        Raises InputError with `where=source.path` for content that is wrong, e.g. by `read_pose` or inside of
        `p2o.files.input_file.naming`.
        """

    @abstractmethod
    def example(self) -> bytes:
        """Return the bytes of a small file of this format, on which `p2o plugin check` tests the reader."""
