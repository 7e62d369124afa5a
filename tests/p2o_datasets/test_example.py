"""The built-in frame is a frame of the simulator: `python -m tests.p2o_datasets.test_example` writes it again."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import p2o
from p2o_datasets import example
from p2o_sim import synthetic
from p2o_sim.write import folder as layout

STEP_M = 0.001


def simulated() -> p2o.Frame:
    """Return the frame of which the built-in one is stored."""
    frame = synthetic.build(synthetic.SyntheticOptions(right=False))[0]
    return dataclasses.replace(frame, name=example.FOLDER.name, image=p2o.Image(frame.image.rgb, frame.camera))


def write(root: Path) -> None:
    """Write the files: the layout of `p2o simulate`, the image as JPEG and the sweep in millimetres."""
    list(layout.write([simulated()], root.parent))
    image = cv2.imread(str(root / "image.png"))
    (root / "image.png").unlink()
    cv2.imwrite(str(root / "image.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    with np.load(root / "cloud.npz") as stored:
        columns = dict(stored)
    columns["xyz"] = np.round(columns["xyz"] / STEP_M).astype(np.int32)
    columns |= {"ring": columns["ring"].astype(np.uint8), "time_s": columns["time_s"].astype(np.float32)}
    np.savez_compressed(root / "cloud.npz", **columns)
    text = (root / "frame.yaml").read_text().replace("image.png", "image.jpg")
    (root / "frame.yaml").write_text(f"{text}cloud_scale: {STEP_M}\n")


def test_the_built_in_frame_is_that_of_the_simulator() -> None:
    """Coordinates are rounded to millimetres, JPEG changes grey levels, and other processors round otherwise."""
    [stored], made = example.build(p2o.Options()), simulated()
    assert (stored.name, stored.camera) == ("street", made.camera)
    np.testing.assert_allclose(stored.camera_from_lidar, made.camera_from_lidar, atol=1e-12)
    np.testing.assert_allclose(stored.start, made.start, atol=1e-12)
    np.testing.assert_allclose(stored.cloud.twist, made.cloud.twist, atol=1e-12)
    assert len(stored.cloud) == len(made.cloud)
    same_ring = stored.cloud.ring == made.cloud.ring
    away_m = np.abs(stored.cloud.xyz - made.cloud.xyz).max(axis=1)
    assert np.mean(same_ring & (away_m <= STEP_M / 2 + 1e-6)) > 0.999
    difference = np.abs(stored.image.rgb.astype(int) - made.image.rgb)
    assert difference.mean() < 2
    assert np.mean(difference <= 16) > 0.99


def test_a_run_without_data_calibrates_it_and_imports_what_it_uses(tmp_path: Path) -> None:
    code = "import sys; from p2o.cli import main; print(main(['run', '--out', 'out'])); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    first, *lines, status, names = done.stdout.splitlines()
    assert (first, status) == ("street", "0")
    assert "  verdict   trusted" in lines
    loaded = set(names.split())
    assert "p2o_datasets.folder" in loaded
    assert not loaded & {"p2o_sim.synthetic", "p2o_datasets.kitti_raw", "p2o_datasets.ros", "p2o_formats.formats"}
    assert {name for name in loaded if name.startswith("p2o_baselines.")} == {"p2o_baselines.hooks"}
    assert not loaded & {"torch", "onnx", "pycolmap", "matplotlib", "scipy.ndimage", "scipy.optimize", "embreex"}


if __name__ == "__main__":
    shutil.rmtree(example.FOLDER, ignore_errors=True)
    write(example.FOLDER)
