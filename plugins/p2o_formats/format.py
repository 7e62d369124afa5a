"""Description of a calibration file format, which provides its reader and its exporter."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from p2o import Camera, Exporter, InputError, Method, Options, Result, se3
from p2o.reading import (
    CAMERA,
    EXTRINSIC,
    Calibration,
    CalibrationReader,
    Reading,
    Source,
    naming,
    numbers,
    provenance,
    write_whole,
)

BOTH = frozenset({CAMERA, EXTRINSIC})
ONLY_CAMERA = frozenset({CAMERA})
ONLY_EXTRINSIC = frozenset({EXTRINSIC})
SIZE = frozenset({"width", "height"})
NAMED_SIZE = SIZE | {"name"}
FRAMES = frozenset({"lidar_frame", "camera_frame"})
"""Fields of `Reading` that several formats use."""

EXAMPLE = Calibration(
    Camera("OPENCV", 640, 480, (500.0, 501.0, 320.25, 240.75, -0.1, 0.01, 0.001, 0.002)),
    se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0.06, -0.08, -0.27]),
)
"""The calibration of the example files, on which the readers are tested."""


@dataclass(frozen=True, kw_only=True)
class Format:
    """One file format.

    `holds` lists the parts (`PARTS`) that the format can store, at least one of which it requires, and `needs` further
    required ones; `direction` names the stored transform. `fields` are those of `Reading` that it uses. `recognises`
    tests the content of a file; formats of lower `rank` are tested first. `write` takes a calibration and `options`. It
    is None for formats that are only read, whose `example` returns the bytes of a file.
    """

    name: str
    summary: str
    rank: int
    recognises: Callable[[Source], bool]
    read: Callable[[Source, Reading], Calibration]
    holds: frozenset[str] = BOTH
    needs: frozenset[str] = frozenset()
    direction: str = ""
    fields: frozenset[str] = frozenset()
    suffix: str = ".yaml"
    options: type[Options] = Options
    write: Callable[[Calibration, Any], bytes] | None = None
    cite: str = ""
    example: Callable[[], bytes] | None = None

    def written(self, calibration: Calibration, options: Options | None = None, where: object = None) -> bytes:
        """Return the bytes of a file with those parts of the calibration that the format can store.

        Raises InputError for formats that are only read, for missing parts, and for camera models that the format
        cannot express.
        """
        if self.write is None:
            raise InputError(f"{self.name} can only be read", where=where, expected="another form", got=self.name)
        lacking = sorted(self.needs - calibration.parts)
        if not self.holds & calibration.parts:
            lacking = lacking or [" or ".join(sorted(self.holds))]
        if lacking:
            fault = f"{self.name} stores {' and '.join(sorted(self.needs or self.holds))}, and there is no {lacking[0]}"
            hint = "give the file of the camera, too (--camera FILE)" if lacking == [CAMERA] else None
            raise InputError(fault, where=where, expected=f"a {lacking[0]}", hint=hint)
        return self.write(calibration, options or self.options())

    def reader(self) -> Method:
        """Return the reader of the format as a method."""
        build = self._build_reader
        return Method(name=self.name, build=build, options=Reading, summary=self.summary, cite=self.cite)

    def _build_reader(self, reading: Reading) -> FormatReader:
        return FormatReader(self, reading)

    def exporter(self) -> Method:
        """Return the exporter of the format as a method."""
        build = self._build_exporter
        return Method(name=self.name, build=build, options=self.options, summary=self.summary, cite=self.cite)

    def _build_exporter(self, options: Options) -> Exporter:
        def export(result: Result, path: Path) -> None:
            if not result.status.solved:
                fault, hint = "the result has no estimated pose to export", "export it as json, which stores the status"
                got = f"{result.status.value} ({result.reason})"
                raise InputError(fault, where=path, expected="a solved calibration", got=got, hint=hint)
            calibration = Calibration(result.intrinsics, result.camera_from_lidar, comment=provenance(result))
            write_whole(path, self.written(calibration, options, path))

        return export


class FormatReader(CalibrationReader):
    """Reader of the files of one `Format`."""

    def __init__(self, form: Format, reading: Reading) -> None:
        self._form, self._reading, self.rank = form, reading, form.rank

    def recognises(self, source: Source) -> bool:
        """Return whether the content of a file has the format."""
        return self._form.recognises(source)

    def read(self, source: Source) -> Calibration:
        """Return the content of a file; raises InputError that names it, also for fields that the format ignores."""
        with naming(source.path):
            for field in sorted(self._reading.model_fields_set - self._form.fields):
                got = str(getattr(self._reading, field))
                if got:
                    fault, expected = f"{field} does not apply to {self._form.name}", sorted(self._form.fields)
                    raise InputError(fault, where=source.path, expected=", ".join(expected) or "no field", got=got)
            return self._form.read(source, self._reading)

    def example(self) -> bytes:
        """Return a file with `EXAMPLE`."""
        return self._form.written(EXAMPLE) if self._form.example is None else self._form.example()


def comment_lines(calibration: Calibration) -> list[str]:
    """Return the comment of a calibration as a line of text formats with `#`; no line without a comment."""
    return [f"# {calibration.comment}"] if calibration.comment else []


def described(calibration: Calibration, text: str) -> str:
    """Return the text of a comment key of JSON, followed by the comment of the calibration."""
    return "; ".join(filter(None, (text, calibration.comment)))


def size_of(width: Any, height: Any, reading: Reading, where: object) -> tuple[int, int] | None:
    """Return the image size in px of a file, or else of the reading; None if neither has one.

    Raises InputError unless it consists of whole numbers, and if both have different ones.
    """
    for ours, other in ((width, reading.width), (height, reading.height)):
        if ours is not None and other is not None and ours != other:
            fault = "the file states another image size"
            raise InputError(fault, where=where, expected=f"{ours} px", got=f"{other} px")
    stated = (reading.width if width is None else width, reading.height if height is None else height)
    if None in stated:
        return None
    if any(isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v) or v % 1 for v in stated):
        raise InputError("the image size is not in whole pixels", where=where, expected="px", got=repr(stated)[:60])
    return int(stated[0]), int(stated[1])  # type: ignore[arg-type]


def data_of(value: Any) -> Any:
    """Return the numbers of an entry {rows, cols, data}; other entries are the numbers themselves."""
    return value.get("data") if isinstance(value, Mapping) else value


def required_numbers(name: str, value: Any, count: int | None, where: object, expected: str) -> list[float]:
    """Return finite numbers of a file; raises InputError for other values or another count (None: any)."""
    if count is None:
        count = len(value) if isinstance(value, list) else -1
    array = numbers(value, (count,))
    if array is None:
        raise InputError(f"{name} are not numbers", where=where, expected=expected, got=str(value)[:60])
    return [float(number) for number in array]


def json_text(tree: Any) -> bytes:
    """Return the text of a JSON file."""
    return (json.dumps(tree, indent=2, allow_nan=False) + "\n").encode()


def select_camera(names: Collection[str], wanted: str | None, form: str, where: object) -> str:
    """Return `wanted`, or the only name if it is empty; raises InputError that expects `form` (FILE#NAME)."""
    if not wanted and len(names) == 1:
        return next(iter(names))
    if not wanted or wanted not in names:
        fault = f"there is no camera {wanted!r}" if wanted else "the file contains several cameras"
        got = wanted or f"{len(names)} cameras"
        raise InputError(fault, where=where, expected=f"{form} with one of {', '.join(list(names)[:8])}", got=got)
    return wanted
