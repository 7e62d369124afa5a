"""Measure the errors for clouds given in another frame than the sensor's: that of a car, or the axes of a camera.

    python benchmarks/cloud_frames.py folder:build/data/rigs/waymo kitti-raw:build/data/kitti_raw#:20:5

Each frame is calibrated from the same wrong start (2 deg, 15 cm, of seed 0 and its number), its points, motion, truth
and start given in its sensor's frame and in others; with the sensor position estimated from the rings
(`cloud.find_sensor=true`, the default) and not. Errors are those of the pose in the frame in which it is given.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import p2o
from p2o import Frame, se3
from p2o.arrays import Float
from p2o.geometry.perturb import parse_perturbation

FRAMES: Mapping[str, Float] = {
    "the sensor's": se3.make(),
    "1.8 m below it": se3.make(None, [0, 0, 1.8]),
    "rear axle, 1.2 m behind and 1.8 m below": se3.make(None, [1.2, 0, 1.8]),
    "axes of a camera": se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])),
}
START = parse_perturbation("2deg 0.15m")


def told_in(frame: Frame, b_from_lidar: Float) -> Frame:
    """Return a frame whose LiDAR points, motion and truth are expressed in another frame b, by b_from_lidar (4, 4)."""
    cloud, truth = frame.cloud, frame.camera_from_lidar
    return replace(
        frame,
        cloud=replace(cloud, xyz=se3.apply(b_from_lidar, cloud.xyz), twist=twist_in(cloud.twist, b_from_lidar)),
        twist=twist_in(frame.twist, b_from_lidar),
        camera_from_lidar=None if truth is None else truth @ se3.inverse(b_from_lidar),
    )


def twist_in(twist: Float | None, b_from_a: Float) -> Float | None:
    """Return the velocity (6,) of a body told in its frame a, rad/s and m/s, told in its frame b: the adjoint."""
    if twist is None:
        return None
    turning = b_from_a[:3, :3] @ twist[:3]
    return np.concatenate([turning, b_from_a[:3, :3] @ twist[3:] - np.cross(turning, b_from_a[:3, 3])])


def errors(data: str, frames: str, find_sensor: bool) -> dict[str, list[tuple[float, float, str]]]:
    """Return, by the frame in which clouds are given, rotation in deg, translation in cm and verdict of each result."""
    registry = p2o.Registry.load()
    plan = p2o.Recipe.of(options={"cloud": {"find_sensor": find_sensor}}).resolve(registry)
    calibrator = plan.assembly().calibrator
    dataset = p2o.Recipe.of(data=data).resolve(registry).dataset()
    part = slice(*(int(number) if number else None for number in frames.split(":"))) if frames else slice(None)
    found: dict[str, list[tuple[float, float, str]]] = {name: [] for name in FRAMES}
    for number in range(len(dataset))[part]:
        own = dataset[number]
        if own.camera_from_lidar is None:
            continue
        truth = own.camera_from_lidar
        error = START.start(truth, np.random.default_rng([0, number])) @ se3.inverse(truth)
        for name, b_from_lidar in FRAMES.items():
            frame = told_in(own, b_from_lidar)
            wanted = truth @ se3.inverse(b_from_lidar)
            result = calibrator.solve([calibrator.prepare(frame.without_truth())], error @ wanted)
            off = p2o.pose_error(result.camera_from_lidar, wanted)
            found[name].append((off.rotation_deg, 100 * off.translation_m, result.verdict.trust.value))
    return found


def row(name: str, found: Sequence[tuple[float, float, str]]) -> str:
    """Return medians, means and verdicts of one kind of frame as a line of a table."""
    numbers = np.array([(deg, cm) for deg, cm, _ in found])
    (deg, cm), (mean_deg, mean_cm) = np.median(numbers, axis=0), np.mean(numbers, axis=0)
    trusted = [(d, c) for d, c, trust in found if trust == "trusted"]
    wrong = sum(d > 1 or c > 30 for d, c in trusted)
    return (
        f"| {name} | {len(found)} | {deg:.3f} / {cm:.1f} | {mean_deg:.3f} / {mean_cm:.1f} | {len(trusted)} ({wrong}) |"
    )


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("data", nargs="+", metavar="DATASET:PATH[#START:STOP:STEP]")
    for text in asked.parse_args().data:
        data, _, frames = text.partition("#")
        print(f"\n{text}\n\n| points told in the frame | results | median, deg / cm | mean | trusted (wrong) |")
        print("|---|---|---|---|---|")
        for find_sensor in (True, False):
            for name, found in errors(data, frames, find_sensor).items():
                print(row(name if find_sensor else f"{name}; not asked where it is", found), flush=True)


if __name__ == "__main__":
    main()
