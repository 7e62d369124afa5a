"""Recordings of a user without ground truth: the data of docs/tutorial/first-day.md.

python -m tests.first_day FOLDER writes FOLDER/mine (images, sweeps and frame.yaml) and FOLDER/drive.bag.
"""

from __future__ import annotations

import sys
from pathlib import Path

import yaml
from p2o import Registry
from p2o.cli import main
from p2o.run.recipe import open_dataset

from tests.bag_files import messages_of, write_bag

KEPT = ("camera", "image", "cloud")
"""Keys of frame.yaml that a user has: no pose of a sensor."""

TF_ERROR = "2deg 0.1m"
"""Error of the transforms of the bag, as of a drawing of the rig."""


def written(root: Path, width_px: int = 800, height_px: int = 300, frames: int = 10) -> Path:
    """Write images and sweeps of a rig that stands still, of one place each, as folders and as a bag of ROS 1."""
    size = f"width_px={width_px}", f"height_px={height_px}", f"scenes={frames}"
    options = ("speed_m_s=0", "right=false", "lidar=hdl-64e", f"start_error={TF_ERROR}", *size)
    words = [word for option in options for word in ("--set", option)]
    assert main(["simulate", str(root / "mine"), "--layout", "folder", "--seed", "5", *words]) == 0
    recorded = list(open_dataset(f"folder:{root / 'mine'}", Registry.load()))
    write_bag(root, messages_of(recorded, drawing=recorded[0].start), "ros1")
    for file in (root / "mine").glob("*/frame.yaml"):
        known = yaml.safe_load(file.read_text(encoding="utf-8"))
        file.write_text(
            yaml.safe_dump({key: known[key] for key in KEPT if key in known}, sort_keys=False), encoding="utf-8"
        )
        (file.parent / "depth.npy").unlink()
    return root


if __name__ == "__main__":
    written(Path(sys.argv[1]))
