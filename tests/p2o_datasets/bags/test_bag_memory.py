"""Reading a bag does not keep its frames in memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from bench import cost_of
from p2o import Camera

from tests import bag_files


def bag(folder: Path, count: int) -> Path:
    """A bag with images of 1242 x 375 px and sweeps of 120,000 points: 3.5 MB a frame."""
    rng = np.random.default_rng(0)
    camera = Camera.pinhole(720, 720, 621, 187, 1242, 375)
    pixels = rng.integers(0, 256, (375, 1242, 3), dtype=np.uint8)
    columns = {axis: rng.uniform(2, 60, 120_000).astype(np.float32) for axis in "xyz"}
    columns |= {"t": np.linspace(0, 1e8, 120_000).astype(np.uint32)}
    columns |= {"ring": (np.arange(120_000) % 64).astype(np.uint16)}

    def messages() -> Iterator[bag_files.Said]:
        yield bag_files.tf([bag_files.transform("lidar", "camera", np.eye(4))])
        for number in range(count):
            time_ns = 10**18 + number * 100_000_000
            yield bag_files.camera_info("/camera_info", time_ns, camera)
            yield bag_files.image("/image", time_ns, pixels)
            yield bag_files.cloud("/points", time_ns, columns)

    return bag_files.write_bag(folder, messages(), "mcap")


@pytest.mark.system
def test_reading_a_bag_does_not_keep_its_frames_in_memory(tmp_path: Path) -> None:
    peaks = [cost_of(["data", "check", f"ros:{bag(tmp_path / str(n), n)}"]).peak_mib for n in (10, 60)]
    assert peaks[1] < peaks[0] + 60, "175 MB more of messages"
