"""An extrinsic in words: that of the data, or of a calibration file."""

from __future__ import annotations

from collections.abc import Sequence

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.formats.files import extrinsic_words, names_file, start_words
from p2o.frames.frame import Frame
from p2o.run.run import common_pose

OF_DATA = {"truth": "camera_from_lidar", "start": "start"}
"""Words for a pose that frames hold, and where they hold it."""


def given_extrinsic(text: str, frames: Sequence[Frame], where: str = "--extrinsic") -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of words, and remarks: `truth`, `start` or a calibration file (`p2o.formats`).

    Raises InputError for a file that is missing or holds no extrinsic, and for data that hold none.
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
    if text.lower().startswith("roughly ") or names_file(text):
        return start_words(text, where)
    return extrinsic_words(text, where)
