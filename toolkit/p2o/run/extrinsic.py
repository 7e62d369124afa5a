"""An extrinsic in words: that of the data, or of a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import expanded, read_text
from p2o.files.parsed_text import parse_yaml
from p2o.frames.frame import Frame
from p2o.geometry.pose_text import numbers, read_extrinsic
from p2o.geometry.rough_start import rough_start
from p2o.run.run import common_pose

OF_DATA = {"truth": "camera_from_lidar", "start": "start"}
"""Words for a pose that frames hold, and where they hold it."""
_KEYS = ("camera_from_lidar", "lidar_from_camera")


def given_extrinsic(text: str, frames: Sequence[Frame], where: str = "--extrinsic") -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of words, and warnings: `truth`, `start` or a file.

    A file holds 12 or 16 numbers, or is YAML or JSON of a pose as `frame.yaml` has it (`p2o.geometry.pose_text`), by
    itself or below the key camera_from_lidar or lidar_from_camera, as in results of `p2o run --out`.

    Raises InputError for a file that is missing or holds no pose, and for data that hold none.
    """
    if text in OF_DATA:
        pose = common_pose(frames, OF_DATA[text])
        if pose is None:
            raise InputError(
                f"the data hold no {'true extrinsic' if text == 'truth' else 'start'}",
                where=where,
                expected="a file with the extrinsic",
                got=text,
            )
        return pose, ()
    if text.startswith("roughly "):
        return rough_start(text, where), ()
    path = expanded(text)
    content = read_text(path, "file of an extrinsic")
    matrix: Any = numbers(content.split(), (4, 4), (3, 4))
    value = matrix.tolist() if matrix is not None else parse_yaml(content, "file of an extrinsic", path)
    if isinstance(value, Mapping):
        said = [key for key in _KEYS if key in value]
        if len(said) == 1:
            value = {said[0]: value[said[0]]}
    return read_extrinsic("the extrinsic", value, path)
