"""Draw hand-eye calibration at work, for docs/comparison-motion.md: `python benchmarks/motion.py [--gallery FOLDER]`.

Above, LiDAR points of one sweep, projected by the extrinsic that was found, and where they are followed to in the next
picture; below, the way of both sensors on a simulated drive, each by its own odometry.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import p2o
from p2o.arrays import Float
from p2o_baselines.hand_eye import HandEyeCalibration, HandEyeOptions, fused_steps
from p2o_baselines.lidar_tracks import trackable
from p2o_baselines.moments import Run, lidar_poses
from p2o_baselines.visual_odometry import follow

DRIVE = (
    "synthetic:?place=street&frames_per_scene=10&period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0&right=false"
    "&seed=2&exposure_ev=0"
)
_SHOWN = 4


def way_of_camera(run: Run, camera_from_lidar: Float, options: HandEyeOptions) -> Float:
    """Return the places (N, 3) of the camera by its own steps, in the LiDAR frame of the first moment."""
    pose = p2o.se3.inverse(camera_from_lidar)
    places = [pose[:3, 3]]
    for first in range(len(run.moments) - 1):
        (_, step), *_ = fused_steps(run, first, [first + 1], camera_from_lidar, options)
        pose = pose @ p2o.se3.inverse(step.second_from_first)
        places.append(pose[:3, 3])
    return np.array(places)


def draw(path: Path) -> None:
    """Write the picture as JPEG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    frames = list(p2o.Recipe.of(data=DRIVE).resolve(p2o.Registry.load()).dataset())
    options = HandEyeOptions()
    method = HandEyeCalibration(options)
    moments = [method.prepare(frame) for frame in frames]
    result = method.solve(moments, np.eye(4))
    found = result.camera_from_lidar
    error = p2o.pose_error(found, frames[0].camera_from_lidar)
    run = Run(tuple(moments), lidar_poses(moments, options.lidar))
    here, later = moments[_SHOWN], moments[_SHOWN + 1]
    uv, xyz = trackable(here.grey, here.camera, None, here.xyz, found, most=options.points)
    there = follow(here.grey, later.grey, uv)
    kept = np.isfinite(there).all(axis=1)
    figure, (above, below) = plt.subplots(2, 1, figsize=(12.4, 7.4), height_ratios=[3.75, 3.4], layout="constrained")
    above.imshow((0.6 * frames[_SHOWN].image.rgb).astype(np.uint8))
    lines = np.stack([uv[kept], there[kept]], axis=1)
    from matplotlib.collections import LineCollection

    distance = np.linalg.norm(xyz[kept], axis=1)
    above.add_collection(LineCollection(lines, array=distance, cmap="turbo_r", linewidths=1.2))
    shown = above.scatter(*uv[kept].T, c=distance, cmap="turbo_r", s=6)
    figure.colorbar(shown, ax=above, label="distance m", shrink=0.9)
    above.set_axis_off()
    above.set_title(f"{int(kept.sum())} LiDAR points, followed to the next picture")
    lidar = run.world_from_lidar[:, :3, 3]
    camera = way_of_camera(run, found, options)
    below.plot(*lidar[:, :2].T, "o-", label="LiDAR, by its sweeps")
    below.plot(*camera[:, :2].T, "s-", label="camera, by LiDAR points followed in its pictures")
    truth = frames[0].camera_from_lidar
    first = frames[0].lidar_world_from_lidar
    true = np.array(
        [(p2o.se3.inverse(first) @ f.lidar_world_from_lidar @ p2o.se3.inverse(truth))[:3, 3] for f in frames]
    )
    below.plot(*true[:, :2].T, "k:", label="camera, truth")
    below.set_aspect("equal", "datalim")
    below.set_xlabel("ahead m")
    below.set_ylabel("left m")
    below.legend(loc="best")
    below.set_title(f"extrinsic without a start: {error.rotation_deg:.2f} deg, {100 * error.translation_m:.1f} cm off")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90, pil_kwargs={"quality": 72})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gallery", type=Path, default=Path("docs/gallery"), help="folder of the picture")
    draw(parser.parse_args().gallery / "hand-eye.jpg")


if __name__ == "__main__":
    main()
