"""A segment of Waymo's release v1: a .tfrecord file, in which each record is a Frame in Protocol Buffers.

Frames follow waymo-research/waymo-open-dataset, src/waymo_open_dataset/dataset.proto (numbers of fields), records
follow TensorFlow: a length, its checksum, the bytes, and their checksum. Checksums are not verified: lengths have to
fit the file, and images and range images have their own. Results have the names of v2. Messages are decoded field by
field, without definitions, by their wire format (protobuf.dev/programming-guides/encoding); groups, which are obsolete,
are refused.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from p2o.reading import read_start

from p2o_datasets.lazy_dataset import damage_explained
from p2o_datasets.waymo_range_image import LENS, MAX_PIXELS, SHUTTER, STAMPS, VELOCITY, grid

SUFFIX = ".tfrecord"
_MAX_RECORD, _MAX_RECORDS = 256 << 20, 100_000
_HEAD = 12
_START = 1 << 16
_TOP = 1
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
_MAX_VARINT_BYTES = 10
_MAX_FIELDS = 100_000
_MAX_PACKED_BYTES = 1000


def segment_name(path: Path) -> str:
    """Return the name of a file's segment, as in v2."""
    return path.name.removesuffix(SUFFIX).removeprefix("segment-").removesuffix("_with_camera_labels")


@dataclass(frozen=True, eq=False)
class RecordSegment:
    """A segment, whose records are read on demand, with the methods and results of `ParquetSegment`."""

    path: Path
    name: str

    def where(self, part: str) -> Path:
        """Return the path of the file, which contains all parts."""
        return self.path

    def images(self, camera: int) -> Mapping[int, int]:
        """Return the positions of records by the time stamps of their frames in microseconds."""
        return self._frames

    def sweeps(self, lidar: int) -> Mapping[int, int]:
        """Return the same as `images`: each frame contains all images and sweeps."""
        return self._frames

    @cached_property
    def camera_rows(self) -> Mapping[int, Mapping[str, Any]]:
        rows = {}
        with self._explained():
            for camera in self._context.all_inner(2):
                lens = camera.reals(2, "<f8").tolist()
                row = dict(zip((f"intrinsic.{name}" for name in LENS), (*lens, *(None,) * len(LENS)), strict=False))
                row |= {"width": camera.whole(4), "height": camera.whole(5), SHUTTER: camera.whole(6)}
                rows[camera.whole(1)] = {**row, "extrinsic.transform": camera.inner(3).reals(1, "<f8")}
        return rows

    @cached_property
    def lidar_rows(self) -> Mapping[int, Mapping[str, Any]]:
        with self._explained():
            lidars = self._context.all_inner(3)
            names = ("extrinsic.transform", *(f"beam_inclination.{name}" for name in ("min", "max", "values")))
            values = [(o.inner(5).reals(1, "<f8"), o.real(3), o.real(4), o.reals(2, "<f8")) for o in lidars]
            return {o.whole(1): dict(zip(names, row, strict=True)) for o, row in zip(lidars, values, strict=True)}

    def image(self, row: int, camera: int) -> Mapping[str, Any]:
        with self._explained():
            message = _named(self._frame(row).all_inner(4), camera)
            jpeg, velocity = message.content(2), message.inner(4)
            values: dict[str, Any] = {"image": None if jpeg is None else bytes(jpeg)}
            # Missing fields are zero.
            values |= {name: velocity.real(number) or 0.0 for number, name in enumerate(VELOCITY, 1)}
            values |= {name: message.real(number) for name, number in zip(STAMPS, (5, 7, 8), strict=True)}
            return {**values, "pose.transform": message.inner(3).reals(1, "<f8")}

    def ranges(self, row: int, lidar: int, where: Path) -> Any:
        with self._explained():
            packed = _named(self._frame(row).all_inner(5), lidar).inner(2).content(2)
        return self._matrix(packed, 4, where)

    def pixel_poses(self, frame_us: int) -> Any:
        with self._explained():
            packed = _named(self._frame(self._frames[frame_us]).all_inner(5), _TOP).inner(2).content(4)
        return None if packed is None else self._matrix(packed, 6, self.path)

    def frame_pose(self, frame_us: int) -> Any:
        with self._explained():
            numbers = self._frame(self._frames[frame_us]).inner(3).reals(1, "<f8")
        return numbers if len(numbers) else None

    @property
    def _context(self) -> Message:
        return self._frame(next(iter(self._frames.values()))).inner(1)

    def _frame(self, start: int) -> Message:
        """Return the Frame of a record, which is not cached: reading it again takes milliseconds."""
        return Message(memoryview(_record_bytes(self.path, start)))

    @cached_property
    def _frames(self) -> Mapping[int, int]:
        """Positions of records by the time stamps of their frames."""
        read_start(self.path, "file of records", 1)
        positions: dict[int, int] = {}
        with self._explained(), self.path.open("rb") as file:
            size, start = self.path.stat().st_size, 0
            while start < size:
                file.seek(start)
                length = _length(file.read(_HEAD))
                if length > min(_MAX_RECORD, size - start - _HEAD - 4) or len(positions) > _MAX_RECORDS:
                    raise ValueError(f"a record of {length} bytes with {size - start - _HEAD} bytes left")
                stamp = _stamp(file.read(min(length, _START))) or _stamp(_record_bytes(self.path, start))
                positions[stamp] = start
                start += _HEAD + length + 4
        return positions

    def _matrix(self, packed: memoryview | None, channels: int, where: Path) -> Any:
        """Return the pixels (H, W, channels) of a compressed MatrixFloat."""
        if packed is None:
            return grid(None, (), channels, where)
        max_bytes = 4 * channels * MAX_PIXELS + 1024
        with self._explained():
            plain = zlib.decompressobj().decompress(packed, max_bytes)
            matrix = Message(memoryview(plain))
            values, sizes = matrix.reals(1, "<f4"), matrix.inner(2).wholes(1)
        return grid(values, sizes, channels, where)

    def _explained(self) -> AbstractContextManager[None]:
        """Convert the exceptions for damaged records to InputError."""
        errors = (ValueError, KeyError, struct.error, zlib.error, OverflowError, MemoryError, OSError)
        fault, expected = "the file of records is damaged, or is not of Waymo", "TFRecord of Frame messages"
        return damage_explained(self.path, fault, expected, *errors)


def _named(messages: list[Message], number: int) -> Message:
    """Return the message of a sensor; raises ValueError if the frame has none."""
    for message in messages:
        if message.whole(1) == number:
            return message
    raise ValueError(f"no data of sensor {number}")


def _record_bytes(path: Path, start: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        length = _length(file.read(_HEAD))
        data = file.read(min(length, _MAX_RECORD))
    if len(data) != length:
        raise ValueError("a truncated record")
    return data


def _length(head: bytes) -> int:
    """Return the length in the head of a record; raises ValueError if the head is incomplete."""
    if len(head) < _HEAD:
        raise ValueError("a truncated record")
    return int(struct.unpack_from("<Q", head)[0])


def _stamp(data: bytes) -> int:
    """Return the time stamp of a frame in microseconds from the start of its bytes; 0 if it is not among them."""
    try:
        return next((value for number, value in fields(memoryview(data)) if number == 2 and isinstance(value, int)), 0)
    except ValueError:  # the bytes end within a field
        return 0


def fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field: integers for varints, bytes for all other wire types.

    Raises ValueError for bytes that are not a message, and for too many fields.
    """
    place = count = 0
    while place < len(data):
        key, place = _varint(data, place)
        kind, count = key & 7, count + 1
        if key < 8 or count > _MAX_FIELDS:
            raise ValueError("a field without a number" if key < 8 else f"more than {_MAX_FIELDS} fields")
        if kind == _VARINT:
            value, place = _varint(data, place)
            yield key >> 3, value
            continue
        if kind == _BYTES:
            length, place = _varint(data, place)
        elif kind in (_EIGHT, _FOUR):
            length = 8 if kind == _EIGHT else 4
        else:
            raise ValueError(f"a field of wire type {kind}")
        if length > len(data) - place:
            raise ValueError(f"a field of {length} bytes with {len(data) - place} bytes left")
        yield key >> 3, data[place : place + length]
        place += length


class Message:
    """Fields of a message by number; a repeated field has several values, for others the last value applies."""

    def __init__(self, data: memoryview) -> None:
        self._values: dict[int, list[int | memoryview]] = {}
        for number, value in fields(data):
            self._values.setdefault(number, []).append(value)

    def whole(self, number: int) -> int:
        """Return an integer, 0 if the field is missing; raises ValueError for another wire type."""
        value = self._values.get(number, [0])[-1]
        if not isinstance(value, int):
            raise ValueError(f"field {number} is not an integer")
        return value

    def content(self, number: int) -> memoryview | None:
        """Return the bytes of a field, None if it is missing; raises ValueError for another wire type."""
        value = self._values.get(number, [None])[-1]
        if isinstance(value, int):
            raise ValueError(f"field {number} has no bytes")
        return value

    def inner(self, number: int) -> Message:
        """Return the message in a field, one without fields if it is missing."""
        return Message(self.content(number) or memoryview(b""))

    def all_inner(self, number: int) -> list[Message]:
        """Return all messages of a repeated field."""
        values = self._values.get(number, [])
        return [Message(value) for value in values if isinstance(value, memoryview)]

    def real(self, number: int) -> float | None:
        """Return a floating point number of 8 or 4 bytes, None if the field is missing."""
        value = self.content(number)
        if value is None:
            return None
        if len(value) not in (4, 8):
            raise ValueError(f"field {number} is not a floating point number")
        return float(struct.unpack("<d" if len(value) == 8 else "<f", value)[0])

    def reals(self, number: int, kind: str) -> Any:
        """Return the floating point numbers (N,) of a repeated field, packed or not."""
        joined = b"".join(value for value in self._values.get(number, []) if isinstance(value, memoryview))
        return np.frombuffer(joined, kind)

    def wholes(self, number: int) -> list[int]:
        """Return the integers of a repeated field, packed or not; raises ValueError for too many."""
        numbers: list[int] = []
        for value in self._values.get(number, []):
            if isinstance(value, int):
                numbers.append(value)
                continue
            if len(value) > _MAX_PACKED_BYTES:
                raise ValueError(f"more than {_MAX_PACKED_BYTES} bytes of integers")
            place = 0
            while place < len(value):
                integer, place = _varint(value, place)
                numbers.append(integer)
        return numbers


def _varint(data: memoryview, place: int) -> tuple[int, int]:
    """Return an integer with 7 bits per byte, and the position after it."""
    value = 0
    for count in range(_MAX_VARINT_BYTES):
        if place >= len(data):
            raise ValueError("a truncated integer")
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << 7 * count
        if byte < 0x80:
            return value, place
    raise ValueError("an integer without an end")
