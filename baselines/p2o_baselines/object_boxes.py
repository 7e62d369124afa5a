"""Objects as both sensors box them, from a file a frame: rectangles in the picture and cuboids in the sweep.

    {"boxes": [{"kind": "car", "uv": [604.0, 170.5, 660.0, 220.0]}],
     "cuboids": [{"kind": "car", "centre": [21.3, 1.9, -0.9], "size": [4.2, 1.8, 1.5], "yaw_deg": 3.0}]}

`uv` is left, top, right, bottom in pixels; `centre` and `size` (length, width, height) are metres in the LiDAR frame,
`yaw_deg` turns the length from x towards y.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.files.file_names import folder_name
from p2o.files.input_file import existing_folder, read_text
from p2o.files.parsed_text import parse_json
from p2o.host.validation import validated
from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Rectangle(_Strict):
    """An object in the picture."""

    kind: str
    uv: tuple[float, float, float, float]


class Cuboid(_Strict):
    """An object in the sweep."""

    kind: str
    centre: tuple[float, float, float]
    size: tuple[Positive, Positive, Positive]
    yaw_deg: float = 0.0

    @property
    def corners(self) -> Float:
        """The corners (8, 3) m, the four lower ones first."""
        x, y, z = (np.array(sign) * half for sign, half in zip(_SIGNS, np.array(self.size) / 2, strict=True))
        cos, sin = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1) + np.array(self.centre)


_SIGNS = ((1, 1, -1, -1) * 2, (1, -1, 1, -1) * 2, (-1,) * 4 + (1,) * 4)


class BoxFile(_Strict):
    """What the file of a frame holds."""

    boxes: tuple[Rectangle, ...] = ()
    cuboids: tuple[Cuboid, ...] = ()


@dataclass(frozen=True, eq=False)
class Objects:
    """Boxes (N, 4) px and corners of cuboids (M, 8, 3) m; `alike` (M, N) tells which are of one kind."""

    boxes: Float
    corners: Float
    alike: Float

    @classmethod
    def of(cls, file: BoxFile) -> Objects:
        """Return the objects of a file."""
        alike = [[cuboid.kind == box.kind for box in file.boxes] for cuboid in file.cuboids]
        return cls(
            np.reshape([box.uv for box in file.boxes], (-1, 4)),
            np.reshape([cuboid.corners for cuboid in file.cuboids], (-1, 8, 3)),
            np.reshape(np.array(alike, np.float64), (len(file.cuboids), len(file.boxes))),
        )


def read_objects(folder: str, name: str) -> Objects | None:
    """Return the objects of the frame `name`, from FOLDER/NAME.json; None where there is no such file.

    What a file name cannot have is `_` in it (2011_09_26_0005_0000000010.json). Raises InputError for a folder that is
    missing and for a file that holds something else.
    """
    path = existing_folder(Path(folder), "boxes") / f"{folder_name(name)}.json"
    if not path.exists():
        return None
    values = parse_json(read_text(path, "file of boxes"), "file of boxes", path)
    if not isinstance(values, dict):
        raise p2o.InputError("the file of boxes is no table", where=path, expected='{"boxes": [], "cuboids": []}')
    return Objects.of(validated(BoxFile, values, where=path))
