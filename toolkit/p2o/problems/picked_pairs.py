"""The file of picked pairs: which pixel shows which LiDAR point, by frame (docs/how-to/pick-points.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from p2o.arrays import Float, checked
from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.files.parsed_text import read_plain
from p2o.files.whole_file import write_whole
from p2o.options import validated

MAX_PAIRS = 10_000
"""Maximum number of picked pairs in one frame."""
_LARGEST = 1e7  # px and m; larger coordinates are invalid

_Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, strict=True)]


@dataclass(frozen=True, eq=False)
class PickedPairs:
    """Pixels `uv` (N, 2), centres at integers, and the points `xyz` (N, 3) m, LiDAR frame, that are seen there."""

    uv: Float
    xyz: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "uv", checked("uv", self.uv, (None, 2), np.float64))
        object.__setattr__(self, "xyz", checked("xyz", self.xyz, (len(self.uv), 3), np.float64))

    @classmethod
    def none(cls) -> PickedPairs:
        """Return no pairs."""
        return cls(np.zeros((0, 2)), np.zeros((0, 3)))

    def __len__(self) -> int:
        return len(self.uv)


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    uv: tuple[_Number, _Number]
    xyz: tuple[_Number, _Number, _Number]


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    frames: dict[str, Annotated[list[_Entry], Field(max_length=MAX_PAIRS)]]


def read_pairs(path: Path | str) -> dict[str, PickedPairs]:
    """Return the pairs of a YAML or JSON file by name of frame; the suffix `.json` selects JSON.

    Raises InputError where the file cannot be read or has another form.
    """
    path = expanded(path)
    content = read_plain(path, "file of pairs")
    if not isinstance(content, dict) or not isinstance(content.get("frames"), dict):
        expected = "frames: {NAME: [{uv: [u, v], xyz: [x, y, z]}, ...]}"
        got = type(content).__name__ if not isinstance(content, dict) else "no mapping of frames"
        raise InputError("the file of pairs has another form", where=path, expected=expected, got=got)
    names = [name for name in content["frames"] if not isinstance(name, str)]
    if names:
        message = "the name of a frame is no text"
        raise InputError(message, where=path, expected="quotation marks around it", got=repr(names[0]))
    frames = validated(_File, content, where=path).frames
    return {
        name: PickedPairs(np.reshape([e.uv for e in entries], (-1, 2)), np.reshape([e.xyz for e in entries], (-1, 3)))
        for name, entries in frames.items()
    }


def write_pairs(path: Path | str, frames: Mapping[str, PickedPairs]) -> None:
    """Write the file, whole or not at all, one pair a line; raises InputError where it cannot be written."""
    path = expanded(path)
    as_json = path.suffix.lower() == ".json"
    listed = {
        name: [
            json.dumps({"uv": [round(x, 3) for x in uv], "xyz": [round(x, 6) for x in xyz]})
            for uv, xyz in zip(pairs.uv.tolist(), pairs.xyz.tolist(), strict=True)
        ]
        for name, pairs in frames.items()
    }
    write_whole(path, (_json(listed) if as_json else _yaml(listed)).encode())


_REMARK = "# uv: pixel, centres at integers; xyz: LiDAR point in metres. Written by p2o pick.\n"


def _yaml(listed: Mapping[str, Sequence[str]]) -> str:
    # A JSON text is a YAML text too: names are quoted whatever they hold.
    lines = {name: "".join(f"\n    - {pair}" for pair in pairs) or " []" for name, pairs in listed.items()}
    frames = [f"  {json.dumps(name)}:{text}" for name, text in lines.items()]
    return _REMARK + ("frames:\n" + "\n".join(frames) if frames else "frames: {}") + "\n"


def _json(listed: Mapping[str, Sequence[str]]) -> str:
    lines = {name: ",".join(f"\n    {pair}" for pair in pairs) for name, pairs in listed.items()}
    frames = [f"  {json.dumps(name)}: [{text}]" for name, text in lines.items()]
    return '{"frames": {\n' + ",\n".join(frames) + "\n}}\n"
