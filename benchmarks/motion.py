"""Draw hand-eye calibration and csc, and measure their coverage, for docs/comparison-motion.md.

    python benchmarks/motion.py [--gallery FOLDER]     # draws the images
    python benchmarks/motion.py --coverage 8           # predicted and true errors on N simulated drives

`hand-eye.jpg`: above, LiDAR points of one sweep, projected by the extrinsic that was found, and where they are followed
to in the next image; below, the way of both sensors on a simulated drive, each by its own odometry. `csc.jpg`: the
map of the images over the surfaces of the LiDAR's map, from above and in one image, by a wrong extrinsic and by the
one that was found.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.solving import Accuracy
from p2o_baselines.motion.csc import CscCalibration, CscOptions, visual_map_of
from p2o_baselines.motion.hand_eye import HandEyeCalibration, HandEyeOptions, fused_steps
from p2o_baselines.motion.lidar_tracks import trackable
from p2o_baselines.motion.moments import Moment, Run, lidar_poses
from p2o_baselines.motion.structure import surface_map
from p2o_baselines.motion.visual_odometry import follow

DRIVE = (
    "synthetic:?place=street&frames_per_scene=10&period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0&right=false"
    "&seed=2&exposure_ev=0"
)
_SHOWN = 4
DRIVES = (
    "synthetic:?place={place}&frames_per_scene={frames}&period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0"
    "&right=false&seed={seed}"
)
_FIRST_SEED = 31
_WRONG = np.array([0.06, -0.06, 0.04, 0.2, 0.2, -0.4])
"""A left update (rad, m) that makes the wrong extrinsic of the image."""


def coverage(drives: int, frames: int) -> None:
    """Print how errors compare with likely ones, on simulated drives of streets and suburbs in turn."""
    registry = p2o.Registry.load()
    methods: dict[str, Any] = {"hand-eye": HandEyeCalibration(HandEyeOptions()), "csc": CscCalibration(CscOptions())}
    rows: dict[str, list[tuple[float, float, Accuracy]]] = {name: [] for name in methods}
    silent = dict.fromkeys(methods, 0)
    for number in range(drives):
        place, seed = ("street", "suburb")[number % 2], _FIRST_SEED + number
        data = DRIVES.format(place=place, frames=frames, seed=seed)
        dataset = list(p2o.Recipe.of(data=data).resolve(registry).dataset())
        truth = dataset[0].camera_from_lidar
        for name, method in methods.items():
            moments = [method.prepare(frame.without_truth()) for frame in dataset]
            result = method.solve(moments, np.eye(4))
            error = p2o.pose_error(result.camera_from_lidar, truth)
            told = result.accuracy if result.status.solved else None
            print(f"{place} {seed} {name}: {error.rotation_deg:.3f} deg {100 * error.translation_m:.1f} cm; ", end="")
            if told is None:
                silent[name] += 1
                print(result.reason, flush=True)
                continue
            rows[name].append((error.rotation_deg, error.translation_m, told))
            print(f"likely {told.rotation_deg:.3f} deg {100 * told.translation_m:.1f} cm", flush=True)
    print("\n| method | drives | not told | rotation within likely | and 95 % | translation within likely | and 95 % |")
    print("|---|---|---|---|---|---|---|")
    for name, each in rows.items():
        print(f"| {name} | {drives} | {silent[name]} | {' | '.join(_shares(each))} |")


def _shares(rows: Sequence[tuple[float, float, Accuracy]]) -> list[str]:
    """Return in how many of the calibrations errors are as likely as said: two of three, and 95 %."""
    inside = [
        [turn <= told.rotation_deg for turn, _, told in rows],
        [turn <= told.rotation_deg_95 for turn, _, told in rows],
        [move <= told.translation_m for _, move, told in rows],
        [move <= told.translation_m_95 for _, move, told in rows],
    ]
    return [f"{sum(each)} of {len(each)}" for each in inside]


def way_of_camera(run: Run, camera_from_lidar: Float, options: HandEyeOptions) -> Float:
    """Return the places (N, 3) of the camera by its own steps, in the LiDAR frame of the first moment."""
    pose = p2o.se3.inverse(camera_from_lidar)
    places = [pose[:3, 3]]
    for first in range(len(run.moments) - 1):
        (_, step), *_ = fused_steps(run, first, [first + 1], camera_from_lidar)
        pose = pose @ p2o.se3.inverse(step.second_from_first)
        places.append(pose[:3, 3])
    return np.array(places)


def draw_structure(path: Path, frames: Sequence[p2o.Frame]) -> None:
    """Write the image of csc as JPEG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    options = CscOptions()
    method = CscCalibration(options)
    moments: list[Moment] = [method.prepare(frame) for frame in frames]
    result = method.solve(moments, np.eye(4))
    truth = frames[0].camera_from_lidar
    error = p2o.pose_error(result.camera_from_lidar, truth)
    run = Run(tuple(moments), lidar_poses(moments, options.lidar))
    seen = visual_map_of(run, 1500)
    surfaces = surface_map([moment.xyz for moment in moments], run.world_from_lidar, cube_m=0.5)
    assert seen is not None
    assert surfaces is not None
    xyz, covariance = seen.in_camera()
    walls = surfaces.flat & (np.abs(surfaces.normal[:, 2]) < 0.5)
    wrong = p2o.se3.exp(_WRONG) @ truth
    figure, places = plt.subplots(
        2, 2, figsize=(13.2, 8.0), height_ratios=[5.0, 2.4], layout="constrained", sharex="row", sharey="row"
    )
    shown = int(np.argmin(np.abs(seen.key_frames - _SHOWN)))
    wrong_error = p2o.pose_error(wrong, truth)
    titles = (
        f"a wrong extrinsic, {wrong_error.rotation_deg:.1f} deg and {100 * wrong_error.translation_m:.0f} cm off",
        f"found without a start, {error.rotation_deg:.2f} deg and {100 * error.translation_m:.1f} cm off",
    )
    steps = p2o.se3.inverse(run.world_from_lidar[seen.key_frames[1:]]) @ run.world_from_lidar[seen.key_frames[:-1]]
    own = seen.camera_from_world[1:] @ p2o.se3.inverse(seen.camera_from_world[:-1])
    for (above, below), pose, title in zip(places.T, (wrong, result.camera_from_lidar), titles, strict=True):
        moved = pose @ steps @ p2o.se3.inverse(pose)
        scale = float(np.median(np.linalg.norm(moved[:, :3, 3], axis=1) / np.linalg.norm(own[:, :3, 3], axis=1)))
        vague = np.sqrt(np.trace(covariance, axis1=1, axis2=2)) * scale
        kept = (vague < 0.5) & (xyz[:, 2] * scale < 40)
        lidar = p2o.se3.apply(p2o.se3.inverse(pose), xyz[kept] * scale)
        world = run.world_from_lidar[seen.key_frames][seen.moment[kept]]
        at = np.einsum("nij,nj->ni", world[:, :3, :3], lidar) + world[:, :3, 3]
        upright = at[:, 2] > -1.2
        above.scatter(*surfaces.centre[walls, :2].T, s=5, c="0.72", label="upright planes of the LiDAR's map")
        above.scatter(*at[upright, :2].T, s=2.0, c="tab:red", label="landmarks of the pictures, above the ground")
        above.plot(*run.world_from_lidar[:, :2, 3].T, "k.-", label="way of the LiDAR")
        above.set(aspect="equal", xlim=(-2, 42), ylim=(-16, 16), xlabel="ahead m", title=title)
        below.imshow((0.55 * frames[int(seen.key_frames[shown])].image.rgb).astype(np.uint8))
        here = moments[int(seen.key_frames[shown])]
        points = p2o.se3.apply(pose, here.xyz)
        uv = here.camera.project(points)
        good = here.camera.in_image(uv) & (points[:, 2] > 1)
        below.scatter(*uv[good][::3].T, c=points[good][::3, 2], cmap="turbo_r", s=0.5, vmin=3, vmax=40)
        own_here = kept & (seen.moment == shown)
        landmarks = xyz[own_here] * scale
        uv = here.camera.project(landmarks)
        image = below.scatter(
            *uv.T, c=landmarks[:, 2], cmap="turbo_r", s=10, vmin=3, vmax=40, edgecolors="white", linewidths=0.3
        )
        below.set_axis_off()
        below.set_title("LiDAR points (small) and landmarks (ringed) by their distance")
    places[0, 0].set_ylabel("left m")
    places[0, 0].legend(loc="lower left")
    figure.colorbar(image, ax=places[1], label="distance m", shrink=0.9)
    figure.savefig(path, dpi=85, pil_kwargs={"quality": 72})
    plt.close(figure)


def draw(path: Path, frames: Sequence[p2o.Frame]) -> None:
    """Write the image of hand-eye calibration as JPEG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    options = HandEyeOptions()
    method = HandEyeCalibration(options)
    moments = [method.prepare(frame) for frame in frames]
    result = method.solve(moments, np.eye(4))
    found = result.camera_from_lidar
    error = p2o.pose_error(found, frames[0].camera_from_lidar)
    run = Run(tuple(moments), lidar_poses(moments, options.lidar))
    here, later = moments[_SHOWN], moments[_SHOWN + 1]
    uv, xyz = trackable(here.grey, here.camera, None, here.xyz, found, most=600)
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
    figure.savefig(path, dpi=90, pil_kwargs={"quality": 72})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gallery", type=Path, default=Path("docs/gallery"), help="folder of the pictures")
    parser.add_argument("--only", choices=("hand-eye", "csc"), help="draw this picture alone")
    parser.add_argument("--coverage", type=int, metavar="DRIVES", help="print predicted errors against true ones")
    parser.add_argument("--drive-frames", type=int, default=8, help="frames of each drive of --coverage")
    asked = parser.parse_args()
    if asked.coverage:
        coverage(asked.coverage, asked.drive_frames)
        return
    frames = list(p2o.Recipe.of(data=DRIVE).resolve(p2o.Registry.load()).dataset())
    asked.gallery.mkdir(parents=True, exist_ok=True)
    if asked.only != "csc":
        draw(asked.gallery / "hand-eye.jpg", frames)
    if asked.only != "hand-eye":
        draw_structure(asked.gallery / "csc.jpg", frames)


if __name__ == "__main__":
    main()
