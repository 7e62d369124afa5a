"""Errors of `p2o rig` on simulated vehicles with 2, 3 and 4 LiDARs and six cameras, and the wrong edges that it finds.

    python benchmarks/rigs_of_lidars.py --seeds 1,2
    python benchmarks/rigs_of_lidars.py --seeds 1 --guesses 5    # only the alignment of sweeps, from wrong guesses

Each seed is a vehicle that stands at `--scenes` places of a street. Each LiDAR is calibrated with each camera (`p2o run
--rig`), from an initial error of 2 deg and 15 cm. Vehicles with fewer LiDARs are parts of that with four. Results are
kept in `--work`, and a second run with other seeds adds to them. An error of `--wrong` is added to one edge at a time,
`--faults` times for each vehicle, and the edges that `p2o rig` excludes are compared with it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from p2o.arrays import Float
from p2o.cli import main as p2o_main
from p2o.errors import InputError
from p2o.files.whole_file import write_whole
from p2o.geometry import se3
from p2o.geometry.perturb import parse_perturbation, wrong_start
from p2o.host.registry import Registry
from p2o.run.recipe import open_dataset
from p2o_rig.alignment import align_sweeps
from p2o_rig.contradictions import consistent
from p2o_rig.extrinsics import RigExtrinsics, estimate_extrinsics, simultaneous
from p2o_rig.sensor_graph import EdgeKind
from p2o_rig.sensors_file import read_sensors
from p2o_sim.synthetic import SyntheticOptions, body_from_lidar, truth_at

CAMERAS = ("front", "left", "back-left", "back", "back-right", "right")
LIDARS = {
    "roof": ("hdl-64e", "0,0,0,0,0,0"),
    "port": ("os1-64", "-0.4,0.7,-0.5,10,0,70"),
    "starboard": ("hdl-32e", "-0.4,-0.7,-0.5,-10,0,-70"),
    "stern": ("vlp-16", "-1.6,0,-0.6,0,8,180"),
}
"""Model and place of the LiDARs; the first one is the reference."""


def data_of(lidar: str, seed: int, scenes: int) -> str:
    model, place = LIDARS[lidar]
    words = f"place=street&scenes={scenes}&right=false&speed_m_s=0&seed={seed}&lidar={model}&lidar_at={place}"
    return f"synthetic:?{words}"


def calibrated(lidar: str, seed: int, options: argparse.Namespace) -> Path:
    """Return the file of the results of a LiDAR with all cameras, which is written if it does not exist."""
    file: Path = options.work / f"{lidar}-{seed}-{options.scenes}-{options.width_px}.json"
    if not file.exists():
        size = f"width_px={options.width_px}&height_px={round(options.width_px * 0.45)}"
        data = f"{data_of(lidar, seed, options.scenes)}&cameras={','.join(CAMERAS)}&{size}"
        text = io.StringIO()
        with contextlib.redirect_stdout(text):
            p2o_main(["run", "--data", data, "--rig", "--extractor", options.extractor, "--json"])
        write_whole(file, text.getvalue().encode())
    return file


def vehicle(count: int, seed: int, options: argparse.Namespace) -> tuple[RigExtrinsics, dict[str, Float]]:
    """Return the estimate of the first `count` LiDARs and all cameras, and the true poses."""
    lidars = {
        lidar: {
            "results": [calibrated(lidar, seed, options).name],
            "sweeps": data_of(lidar, seed, options.scenes) + "&width_px=64&height_px=64",
        }
        for lidar in list(LIDARS)[:count]
    }
    file = options.work / f"sensors-{count}-{seed}.json"
    write_whole(file, json.dumps({"lidars": lidars, "cameras": CAMERAS}).encode())
    truth = {lidar: body_from_lidar(SyntheticOptions(lidar_at=LIDARS[lidar][1])) for lidar in lidars}
    truth |= {camera: se3.inverse(truth_at(SyntheticOptions(), 0, 0, camera)) for camera in CAMERAS}
    return estimate_extrinsics(read_sensors(file), Registry.load()), truth


def errors_of(poses: Sequence[tuple[Float, Float]]) -> str:
    """Return median and maximum of the errors of pairs (estimate, truth) of poses (4, 4)."""
    if not poses:
        return "-"
    steps = [se3.inverse(truth) @ estimate for estimate, truth in poses]
    turns, shifts = [se3.angle_deg(step) for step in steps], [100 * se3.distance_m(step) for step in steps]
    return f"{np.median(turns):.3f} deg {np.median(shifts):.2f} cm, {max(turns):.2f} deg {max(shifts):.1f} cm"


def pairs_of(
    rig: RigExtrinsics, truth: dict[str, Float], kind: str
) -> tuple[list[tuple[Float, Float]], list[tuple[Float, Float]]]:
    """Return pairs (estimate, truth) before and after the graph: cameras in LiDARs, or LiDARs in LiDARs.

    Before are the own results of camera and LiDAR, and for two LiDARs the chain of results through each camera.
    """
    results = {(e.parent, e.child): e.parent_from_child for e in rig.edges if e.kind is EdgeKind.RESULT}
    poses = rig.graph.solution.poses
    before, after = [], []
    lidars = [name for name in truth if name not in CAMERAS]
    both = [(c, i) for c in CAMERAS for i in lidars] if kind == "camera" else list(combinations(lidars, 2))
    for first, second in both:
        true = se3.inverse(truth[first]) @ truth[second]
        if first in poses and second in poses:
            after.append((se3.inverse(poses[first]) @ poses[second], true))
        if kind == "camera":
            before += [(results[first, second], true)] if (first, second) in results else []
            continue
        for camera in CAMERAS:
            if (camera, first) in results and (camera, second) in results:
                before.append((se3.inverse(results[camera, first]) @ results[camera, second], true))
    return before, after


def within_bounds(rig: RigExtrinsics, truth: dict[str, Float]) -> Iterator[bool]:
    """Yield for each sensor whether its error is below the 95 % bounds of rotation and translation."""
    for sensor in rig.sensors:
        if sensor.name == rig.reference or sensor.reference_from_sensor is None or sensor.accuracy is None:
            continue
        step = se3.inverse(truth[sensor.name]) @ sensor.reference_from_sensor
        bounds = sensor.accuracy.rotation_deg_95, sensor.accuracy.translation_m_95
        yield se3.angle_deg(step) <= bounds[0] and se3.distance_m(step) <= bounds[1]


def faults(rig: RigExtrinsics, count: int, wrong: str, seed: int) -> Iterator[str]:
    """Add an error to one edge at a time; yield which edges are excluded, in words.

    The error rotates and translates the child about random axes. Of two edges that explain it equally well, the one
    that is not trusted on its own is excluded.
    """
    rng, size = np.random.default_rng(seed), parse_perturbation(wrong)
    for number in rng.permutation(len(rig.graph.used))[:count]:
        edges = list(rig.graph.used)
        pose = wrong_start(edges[number].parent_from_child, size.angle_deg, size.distance_m, rng)
        edges[number] = replace(edges[number], parent_from_child=pose)
        excluded = [edge for one in consistent(edges, rig.reference).contradictions for edge in one.edges]
        if edges[number] in excluded:
            yield "excluded" if len(excluded) == 1 else f"excluded with {len(excluded) - 1} others"
        elif excluded:
            trusted = all(edge.trusted for edge in excluded)
            yield "another edge excluded" if trusted else "an edge excluded that is not trusted on its own"
        else:
            yield "not found"


def converged(guess: str, draws: int, options: argparse.Namespace) -> Iterator[bool]:
    """Align the first LiDAR with each other one from guesses with an error; yield whether the result is correct."""
    size, registry, seed = parse_perturbation(guess), Registry.load(), options.seeds[0]
    first, *others = (
        open_dataset(data_of(lidar, seed, options.scenes) + "&width_px=64&height_px=64", registry) for lidar in LIDARS
    )
    for dataset, (_, place) in zip(others, list(LIDARS.values())[1:], strict=True):
        pairs, rng = simultaneous(first, dataset, options.scenes), np.random.default_rng(seed)
        truth = body_from_lidar(SyntheticOptions(lidar_at=place))
        for _ in range(draws):
            try:
                pose = align_sweeps(pairs, wrong_start(truth, size.angle_deg, size.distance_m, rng)).first_from_second
            except InputError:
                yield False
                continue
            step = se3.inverse(truth) @ pose
            yield se3.angle_deg(step) < 0.3 and se3.distance_m(step) < 0.05


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=lambda text: [int(word) for word in text.split(",")], default=[1, 2])
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--width-px", type=int, default=621)
    parser.add_argument("--extractor", default="p2ornet/rings")
    parser.add_argument("--wrong", default="1deg 0.1m")
    parser.add_argument("--faults", type=int, default=6)
    parser.add_argument("--guesses", type=int, default=0, help="draws of each error of the initial guess of sweeps")
    parser.add_argument("--work", type=Path, default=Path("build/rigs-of-lidars"))
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    for guess in ("1deg 0.2m", "3deg 0.5m", "6deg 1m") if options.guesses else ():
        correct = list(converged(guess, options.guesses, options))
        print(f"sweeps aligned from {guess}: {sum(correct)} of {len(correct)} within 0.3 deg and 5 cm", flush=True)
    if options.guesses:
        return
    for count in (2, 3, 4):
        rigs = [vehicle(count, seed, options) for seed in options.seeds]
        print(f"{count} LiDARs, {len(CAMERAS)} cameras, {len(rigs)} vehicles; errors are medians, then maxima")
        for kind, label in (("camera", "camera-LiDAR, own result"), ("lidar", "LiDAR-LiDAR through one camera")):
            before, after = (
                [pair for rig, truth in rigs for pair in pairs_of(rig, truth, kind)[side]] for side in (0, 1)
            )
            print(f"  {label}: {errors_of(before)} (n = {len(before)})")
            print(f"  {label.partition(' ')[0].rstrip(',')}, graph: {errors_of(after)} (n = {len(after)})")
        bounds = [inside for rig, truth in rigs for inside in within_bounds(rig, truth)]
        print(f"  within the 95 % bounds: {sum(bounds)} of {len(bounds)} sensors")
        excluded = [one.text for rig, _ in rigs for one in rig.graph.contradictions]
        print(f"  excluded without an added error: {len(excluded)} {' | '.join(excluded)}")
        left_out = [f"{one.name}: {one.reason}" for rig, _ in rigs for one in rig.left_out]
        print(f"  left out: {len(left_out)} {' | '.join(left_out)}")
        seeds = zip(rigs, options.seeds, strict=True)
        outcomes = [one for (rig, _), seed in seeds for one in faults(rig, options.faults, options.wrong, seed)]
        counts = ", ".join(f"{outcomes.count(word)} {word}" for word in sorted(set(outcomes)))
        print(f"  one edge wrong by {options.wrong}: {counts} (n = {len(outcomes)})", flush=True)


if __name__ == "__main__":
    main()
