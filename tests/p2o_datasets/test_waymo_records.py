"""Waymo v1: a segment of records gives the frames that the same segment of v2 gives; damage is one line."""

from __future__ import annotations

import random
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError

from .opened import opened, refused
from .waymo_files import SEGMENT, START_US, Segment
from .waymo_record_files import frames, message, record, whole, write_records

dataset = partial(opened, "waymo")


@pytest.mark.parametrize("lidar", ["TOP", "REAR"])
def test_records_give_the_frames_of_the_release_v2(tmp_path: Path, lidar: str) -> None:
    segment = Segment(tmp_path / "v1")
    write_records(segment)
    new = dataset(Segment(tmp_path / "v2").write(), cameras="FRONT,SIDE_LEFT", lidar=lidar)
    old = dataset(segment.root, cameras="FRONT,SIDE_LEFT", lidar=lidar)
    assert old.names == new.names
    assert len(old) == 6
    for one, other in zip(old, new, strict=True):
        assert one.camera == other.camera
        assert np.array_equal(one.image.rgb, other.image.rgb)
        assert np.abs(one.cloud.xyz - other.cloud.xyz).max() < 1e-6
        assert np.array_equal(one.cloud.ring, other.cloud.ring)
        assert np.array_equal(one.cloud.intensity, other.cloud.intensity)
        assert np.array_equal(one.camera_from_lidar, other.camera_from_lidar)
        assert np.abs(one.lidar_world_from_lidar - other.lidar_world_from_lidar).max() < 1e-6
        assert np.abs(one.twist - other.twist).max() < 1e-5
        assert (one.sequence, one.time_s, one.camera_name) == (other.sequence, other.time_s, other.camera_name)


def test_a_frame_whose_start_is_long_is_found(tmp_path: Path) -> None:
    segment = Segment(tmp_path)
    padded = [message(1000, bytes(1 << 17)) + data for data in frames(segment)]
    write_records(segment, padded)
    assert dataset(tmp_path).names[0] == f"{SEGMENT}/FRONT/{START_US}"
    assert len(dataset(tmp_path)[1].cloud) > 100


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data[:-2000], "a record of .* bytes with"),
        (lambda data: data[:5], "a truncated record"),
        (lambda data: b"not a record at all", "a record of .* bytes with"),
        (lambda data: record(b"\xff" * 20), "the file of records is damaged"),
        (lambda data: record(whole(2, 5)), "a sensor has no calibration|no data of sensor"),
        (lambda data: record(b"\x0b"), "the file of records is damaged"),
        (lambda data: b"", "is empty|no Waymo frames"),
    ],
)
def test_files_that_are_damaged_are_one_line(tmp_path: Path, change: Any, words: str) -> None:
    path = write_records(Segment(tmp_path))
    path.write_bytes(change(path.read_bytes()))
    with refused(words, "" if "no Waymo" in words else path.name):
        dataset(tmp_path)[0]


def test_damage_anywhere_is_one_line_or_another_frame(tmp_path: Path) -> None:
    rng = random.Random(0)
    path = write_records(Segment(tmp_path))
    whole_file = path.read_bytes()
    said = []
    for _ in range(60):
        data = bytearray(whole_file)
        for _ in range(rng.choice((1, 3))):
            # The small fields are in front.
            data[rng.randrange(rng.choice((1500, 1500, len(data))))] = rng.randrange(256)
        path.write_bytes(data)
        try:
            dataset(tmp_path)[0]
        except InputError as problem:
            said.append(str(problem))
    assert len(said) > 20
    assert not any("\n" in text for text in said)


@pytest.mark.parametrize(
    ("piece", "count", "words"),
    [
        (b"\0", 1 << 27, "a field without a number"),
        (b"\x18\0", 1 << 22, "more than 100000 fields"),
        (b"\x0a\0", 1 << 22, "more than 100000 fields"),
        (b"\x12\x82\x10\x0a\xff\x0f" + bytes(2047), 1, "more than 1000 bytes of integers"),
    ],
)
def test_a_range_image_that_is_too_large_is_refused(tmp_path: Path, piece: bytes, count: int, words: str) -> None:
    segment = Segment(tmp_path)
    bomb = message(5, whole(1, 1), message(2, message(2, zlib.compress(piece * count, 1))))
    # Of several fields of one sensor the first counts.
    write_records(segment, [bomb + data for data in frames(segment)])
    with refused(words):
        dataset(tmp_path)[0]
