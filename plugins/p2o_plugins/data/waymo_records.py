"""A segment of Waymo's release v1: a .tfrecord file, each record a Frame in Protocol Buffers.

Frames as waymo-research/waymo-open-dataset defines them, src/waymo_open_dataset/dataset.proto (numbers of fields), and
records as TensorFlow writes them: a length, its checksum, the bytes, and theirs. Checksums of the bytes are not looked
at: images and range images have their own. What is asked for has the words of v2.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from p2o import InputError
from p2o.files.input_file import read_start

from p2o_plugins.data.protobuf_wire import Message, fields
from p2o_plugins.data.waymo_range_image import LENS, MAX_PIXELS, SHUTTER, STAMPS, VELOCITY, grid

SUFFIX = ".tfrecord"
_MAX_RECORD, _MAX_RECORDS = 256 << 20, 100_000
_HEAD = 12
_START = 1 << 16
_TOP = 1
# CRC-32C, and how TensorFlow masks it.
_POLYNOMIAL, _MASK = 0x82F63B78, 0xA282EAD8


def segment_name(path: Path) -> str:
    """Return the name of the segment of a file, as v2 has it."""
    return path.name.removesuffix(SUFFIX).removeprefix("segment-").removesuffix("_with_camera_labels")


@dataclass(frozen=True, eq=False)
class RecordSegment:
    """A segment: its records, which are read when they are asked for. Sensors are named by their numbers."""

    path: Path
    name: str

    def where(self, part: str) -> Path:
        """Return the file, which holds all parts."""
        return self.path

    def images(self, camera: int) -> Mapping[int, int]:
        """Return where records begin by the stamps of their frames in microseconds."""
        return self._frames

    def sweeps(self, lidar: int) -> Mapping[int, int]:
        """Return the same: every frame holds all images and sweeps."""
        return self._frames

    @cached_property
    def camera_rows(self) -> Mapping[int, Mapping[str, Any]]:
        """What calibrates each camera: `LENS`, extrinsic.transform, width, height and `SHUTTER`."""
        found = {}
        with self._explained():
            for said in self._context.all_inner(2):
                lens = said.reals(2, "<f8").tolist()
                row = dict(zip((f"intrinsic.{name}" for name in LENS), (*lens, *(None,) * len(LENS)), strict=False))
                row |= {"width": said.whole(4), "height": said.whole(5), SHUTTER: said.whole(6)}
                found[said.whole(1)] = {**row, "extrinsic.transform": said.inner(3).reals(1, "<f8")}
        return found

    @cached_property
    def lidar_rows(self) -> Mapping[int, Mapping[str, Any]]:
        """What calibrates each LiDAR: extrinsic.transform and inclinations of its beams."""
        with self._explained():
            return {
                said.whole(1): {
                    "extrinsic.transform": said.inner(5).reals(1, "<f8"),
                    "beam_inclination.min": said.real(3),
                    "beam_inclination.max": said.real(4),
                    "beam_inclination.values": said.reals(2, "<f8"),
                }
                for said in self._context.all_inner(3)
            }

    def image(self, row: int, camera: int) -> Mapping[str, Any]:
        """Return a JPEG (`image`), `pose.transform`, `VELOCITY` and `STAMPS` of an image."""
        with self._explained():
            said = _named(self._frame(row).all_inner(4), camera)
            jpeg, velocity = said.content(2), said.inner(4)
            found: dict[str, Any] = {"image": None if jpeg is None else bytes(jpeg)}
            # Fields that are left out are zero.
            found |= {name: velocity.real(number) or 0.0 for number, name in enumerate(VELOCITY, 1)}
            found |= {name: said.real(number) for name, number in zip(STAMPS, (5, 7, 8), strict=True)}
            return {**found, "pose.transform": said.inner(3).reals(1, "<f8")}

    def ranges(self, row: int, lidar: int, where: Path) -> Any:
        """Return the first returns (H, W, 4) of a sweep: range in metres, intensity, elongation, a flag."""
        with self._explained():
            said = _named(self._frame(row).all_inner(5), lidar).inner(2).content(2)
        return self._matrix(said, 4, where)

    def pixel_poses(self, frame_us: int) -> Any:
        """Return the poses (H, W, 6) of the top LiDAR's pixels, None where the frame has none."""
        with self._explained():
            said = _named(self._frame(self._frames[frame_us]).all_inner(5), _TOP).inner(2).content(4)
        return None if said is None else self._matrix(said, 6, self.path)

    def frame_pose(self, frame_us: int) -> Any:
        """Return the numbers of a frame's world_from_vehicle, None where it has none."""
        with self._explained():
            numbers = self._frame(self._frames[frame_us]).inner(3).reals(1, "<f8")
        return numbers if len(numbers) else None

    @property
    def _context(self) -> Message:
        return self._frame(next(iter(self._frames.values()))).inner(1)

    def _frame(self, start: int) -> Message:
        """Return the Frame of a record. It is not kept: reading some megabytes again takes milliseconds."""
        return Message(memoryview(_record_bytes(self.path, start)))

    @cached_property
    def _frames(self) -> Mapping[int, int]:
        """Where records begin, by the stamps of their frames."""
        read_start(self.path, "file of records", 1)
        found: dict[int, int] = {}
        with self._explained(), self.path.open("rb") as file:
            size, start = self.path.stat().st_size, 0
            while start < size:
                file.seek(start)
                length = _length(file.read(_HEAD))
                if length > min(_MAX_RECORD, size - start - _HEAD - 4) or len(found) > _MAX_RECORDS:
                    raise ValueError(f"a record of {length} bytes where {size - start - _HEAD} are left")
                found[_stamp(file.read(min(length, _START))) or _stamp(_record_bytes(self.path, start))] = start
                start += _HEAD + length + 4
        return found

    def _matrix(self, packed: memoryview | None, channels: int, where: Path) -> Any:
        """Return the pixels (H, W, channels) of a compressed MatrixFloat."""
        if packed is None:
            return grid(None, (), channels, where)
        most = 4 * channels * MAX_PIXELS + 1024
        with self._explained():
            plain = zlib.decompressobj().decompress(packed, most)
            matrix = Message(memoryview(plain))
            values, sizes = matrix.reals(1, "<f4"), matrix.inner(2).wholes(1)
        return grid(values, sizes, channels, where)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Raise InputError for what damage makes of records."""
        try:
            yield
        except (ValueError, KeyError, struct.error, zlib.error, OverflowError, MemoryError, OSError) as problem:
            raise InputError(
                "the file of records is damaged, or is none of Waymo's",
                where=self.path,
                expected="TFRecord of Frame messages",
                got=str(problem)[:200] or type(problem).__name__,
                hint="take it from its source again",
            ) from problem


def _named(messages: list[Message], number: int) -> Message:
    """Return the message of a sensor; raises ValueError where the frame has none."""
    found = next((message for message in messages if message.whole(1) == number), None)
    if found is None:
        raise ValueError(f"no data of sensor {number}")
    return found


def _record_bytes(path: Path, start: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        length = _length(file.read(_HEAD))
        data = file.read(min(length, _MAX_RECORD))
    if len(data) != length:
        raise ValueError("a record that is cut off")
    return data


def _length(head: bytes) -> int:
    """Return the length that the head of a record says; raises ValueError where its checksum does not fit."""
    if len(head) < _HEAD:
        raise ValueError("a record that is cut off")
    length, checksum = struct.unpack("<QI", head)
    crc = _crc(head[:8])
    if checksum != ((crc >> 15 | crc << 17) + _MASK) & 0xFFFFFFFF:
        raise ValueError("a length whose checksum does not fit")
    return int(length)


def _crc(data: bytes) -> int:
    """Return the CRC-32C of a few bytes."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (_POLYNOMIAL if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def _stamp(data: bytes) -> int:
    """Return the stamp of a frame in microseconds, near the start of its bytes; 0 where it is not among these."""
    try:
        return next((value for number, value in fields(memoryview(data)) if number == 2 and isinstance(value, int)), 0)
    except ValueError:  # the rest of the record
        return 0
