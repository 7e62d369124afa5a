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
from p2o.files.input_file import expanded, read_text
from p2o.files.parsed_text import parse_json, parse_yaml
from p2o.files.whole_file import write_whole
from p2o.host.validation import validated

MAX_PAIRS = 10_000
"""Nobody picks more in one frame."""
_LARGEST = 1e7  # pixels and metres; what is larger is no place

_Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, strict=True)]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pixels `uv` (N, 2), centres at integers, and the points `xyz` (N, 3) m, LiDAR frame, that are seen there."""

    uv: Float
    xyz: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "uv", checked("uv", self.uv, (None, 2), np.float64))
        object.__setattr__(self, "xyz", checked("xyz", self.xyz, (len(self.uv), 3), np.float64))

    @classmethod
    def none(cls) -> Pairs:
        """Return no pairs."""
        return cls(np.zeros((0, 2)), np.zeros((0, 3)))

    def __len__(self) -> int:
        return len(self.uv)


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    uv: tuple[_Number, _Number]
    xyz: tuple[_Number, _Number, _Number]


class _Listed(BaseModel):
    model_config = ConfigDict(extra="forbid")
    pairs: Annotated[list[_Entry], Field(max_length=MAX_PAIRS)]


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    frames: dict[str, Annotated[list[_Entry], Field(max_length=MAX_PAIRS)]]


def read_pairs(path: Path | str) -> dict[str, Pairs]:
    """Return the pairs of a YAML or JSON file by name of frame; the suffix `.json` says which.

    Raises InputError where the file cannot be read or has another form.
    """
    path = expanded(path)
    text = read_text(path, "file of pairs")
    parse = parse_json if path.suffix.lower() == ".json" else parse_yaml
    content = parse(text, "file of pairs", path)
    if not isinstance(content, dict) or not isinstance(content.get("frames"), dict):
        raise InputError(
            "the file of pairs has another form",
            where=path,
            expected="frames: {NAME: [{uv: [u, v], xyz: [x, y, z]}, ...]}",
            got=type(content).__name__ if not isinstance(content, dict) else "no mapping of frames",
        )
    names = [name for name in content["frames"] if not isinstance(name, str)]
    if names:
        raise InputError(
            "the name of a frame is no text", where=path, expected="quotation marks around it", got=repr(names[0])
        )
    found = validated(_File, content, where=path)
    return {name: _pairs(entries) for name, entries in found.frames.items()}


def pairs_of(values: object, where: object = None) -> Pairs:
    """Return pairs of plain values, a list of {"uv": [u, v], "xyz": [x, y, z]}; InputError for any other form."""
    return _pairs(validated(_Listed, {"pairs": values}, where=where).pairs)


def as_values(pairs: Pairs) -> list[dict[str, list[float]]]:
    """Return pairs as plain values, ready for JSON: the reverse of `pairs_of`."""
    return [
        {"uv": [round(x, 3) for x in uv], "xyz": [round(x, 6) for x in xyz]}
        for uv, xyz in zip(pairs.uv.tolist(), pairs.xyz.tolist(), strict=True)
    ]


def write_pairs(path: Path | str, frames: Mapping[str, Pairs]) -> None:
    """Write the file, whole or not at all, one pair a line; raises InputError where it cannot be written."""
    path = expanded(path)
    as_json = path.suffix.lower() == ".json"
    listed = {name: [json.dumps(pair) for pair in as_values(pairs)] for name, pairs in frames.items()}
    write_whole(path, (_json(listed) if as_json else _yaml(listed)).encode())


_REMARK = "# uv: pixel, centres at integers; xyz: LiDAR point in metres. Written by p2o pick.\n"


def _yaml(listed: Mapping[str, Sequence[str]]) -> str:
    # A JSON text is a YAML text too: names are quoted whatever they hold.
    frames = [f"  {json.dumps(name)}:" + ("" if pairs else " []") + _lines(pairs) for name, pairs in listed.items()]
    return _REMARK + ("frames:\n" + "\n".join(frames) if frames else "frames: {}") + "\n"


def _lines(pairs: Sequence[str]) -> str:
    return "".join(f"\n    - {pair}" for pair in pairs)


def _json(listed: Mapping[str, Sequence[str]]) -> str:
    frames = [
        f"  {json.dumps(name)}: [" + ",".join(f"\n    {p}" for p in pairs) + "]" for name, pairs in listed.items()
    ]
    return '{"frames": {\n' + ",\n".join(frames) + "\n}}\n"


def _pairs(entries: Sequence[_Entry]) -> Pairs:
    if not entries:
        return Pairs.none()
    return Pairs(np.array([entry.uv for entry in entries]), np.array([entry.xyz for entry in entries]))
