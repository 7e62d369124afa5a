"""How often `matches` finds the pose without an initial guess, alone and refined by the default method.

    python benchmarks/matches.py --root build/data --set calibrator.upright=true --out build/matches.jsonl
    python benchmarks/matches.py --table build/matches.jsonl

Each frame is calibrated alone. The initial guess given to `matches` is the identity, which it does not use; its result
is the initial guess of the default method. Success is an error within 1 deg and 30 cm, and within 3 deg and 50 cm;
refused frames count as failures. Frames are development frames of benchmarks/splits.json and simulated ones.
`--out FILE` keeps finished frames, which are not calibrated again; `--table FILE` prints their table.
About 40 minutes of one core.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o.frames.frame import Frame
from p2o.frames.selection import select
from p2o.host.registry import Registry
from p2o.run.recipe import Recipe
from p2o.run.words import parse_settings

_DWELL = "scenes=3&sweep_s=2&speed_m_s=0&right=false&seed=43"
_SETS = {
    "mid-360, 2 s, street": (f"synthetic:?place=street&lidar=mid-360&{_DWELL}", "all", ""),
    "mid-360, 2 s, room": (f"synthetic:?place=room&lidar=mid-360&{_DWELL}", "all", ""),
    "mid-40, 2 s, street": (f"synthetic:?place=street&lidar=mid-40&{_DWELL}", "all", ""),
    "mid-40, 2 s, hall": (f"synthetic:?place=hall&lidar=mid-40&{_DWELL}", "all", ""),
    "KITTI drive 0005, 11 sweeps joined": ("kitti-raw:{}/kitti_raw", "90,103,116,129,142", "poses"),
    "KITTI odometry 00, one sweep": ("kitti-odometry:{}/kitti_odometry", "0,5,10,15,20", ""),
    "Waymo, one sweep": ("folder:{}/rigs/waymo", "0,3,6", ""),
    "nuScenes, one sweep": ("folder:{}/rigs/nuscenes", "0,2,4", ""),
    "PJLab, one sweep": ("folder:{}/rigs/pjlab", "all", ""),
    "hitsz, one sweep": ("folder:{}/rigs/hitsz", "0,2", ""),
    "VLP-16 (ACFR), one sweep": ("folder:{}/rigs/acfr_vlp16", "0,10", ""),
    "DDAD, one sweep": ("folder:{}/rigs/ddad", "0,3,6", ""),
    "KITTI train, one sweep": ("kitti-raw:{}/kitti_raw", "@benchmarks/splits.json#train", ""),
}
"""Name of each row: data, frames, and how sweeps are joined."""
_DRIVE = "2011_09_26/0005/0000000{:03d}"
_SENSOR_OFFSET_M = {"DDAD, one sweep": 2.5, "nuScenes, one sweep": 1.5}
_OF_TRAIN = 16
HEADER = (
    "| frames | n | refused | alone: within 1 deg 30 cm | within 3 deg 50 cm | median deg, cm "
    "| refined: within 1 deg 30 cm | within 3 deg 50 cm | median deg, cm | trusted, false accepts |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)
"""Head of the table; medians are those of solved frames."""
"""Every n-th frame of `train`."""


def frames_of(name: str, root: str, registry: Registry) -> Iterator[Frame]:
    """Yield the frames of a row."""
    data, frames, accumulate = _SETS[name]
    settings = parse_settings(["accumulate.past=5", "accumulate.future=5"] if accumulate else [])
    plan = Recipe.of(data=data.format(root), accumulate=accumulate or None, options=settings).resolve(registry)
    dataset = plan.dataset()
    if accumulate:
        frames = ",".join(_DRIVE.format(int(number)) for number in frames.split(","))
    chosen = select(dataset.names, frames)
    for index in chosen[::_OF_TRAIN] if frames.startswith("@") else chosen:
        yield dataset[index]


def measured(frame: Frame, options: list[str]) -> dict[str, Any]:
    """Return errors (deg, m) of `matches` and of the default method that starts at its result."""
    truth = frame.camera_from_lidar
    if frame.cloud.intensity is None:
        return {"frame": frame.name, "reason": "no intensity"}
    # The methods must not receive the truth, and the identity is the initial guess.
    result = p2o.calibrate(frame, calibrator="matches", start=np.eye(4), options=options, witness="none").result
    row: dict[str, Any] = {"frame": frame.name, "status": str(result.status), "reason": result.reason}
    row["agree"] = result.matches["agree"]
    if result.status.solved:
        row["matches"] = error(result.camera_from_lidar, truth)
        refined = p2o.calibrate(frame, start=result.camera_from_lidar).result
        row["refined"] = error(refined.camera_from_lidar, truth) if refined.status.solved else None
        row["trusted"] = bool(refined.status.solved and refined.verdict.trusted)
    return row


def error(pose: Any, truth: Any) -> list[float]:
    """Return the error of a pose in deg and m."""
    away = p2o.pose_error(pose, truth)
    return [away.rotation_deg, away.translation_m]


def main() -> None:
    """Print a table, a row for each data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", default="build/data", help="folder of kitti_raw, kitti_odometry and rigs")
    parser.add_argument("--only", action="append", metavar="TEXT", help="rows whose name contains TEXT")
    parser.add_argument("--most", type=int, help="frames per row, the first ones")
    parser.add_argument(
        "--set", action="append", default=[], metavar="STAGE.FIELD=VALUE", help="an option of the method"
    )
    parser.add_argument("--out", type=Path, help="file of finished frames, one JSON object per line")
    parser.add_argument("--table", type=Path, help="file of finished frames: print their table only")
    arguments = parser.parse_args()
    print(HEADER, flush=True)
    if arguments.table:
        finished = [json.loads(line) for line in arguments.table.read_text().splitlines()]
        for name in _SETS:
            if rows := [row for row in finished if row["set"] == name]:
                print(table_row(name, rows))
        return
    registry = Registry.load()
    known: dict[tuple[str, str], dict[str, Any]] = {}
    if arguments.out and arguments.out.exists():
        lines = map(json.loads, arguments.out.read_text().splitlines())
        known = {(line["set"], line["frame"]): line for line in lines}
    names = [name for name in _SETS if not arguments.only or any(text in name for text in arguments.only)]
    for name in names:
        options = [f"calibrator.offset_m={_SENSOR_OFFSET_M.get(name, 1.0)}"]
        options += arguments.set
        rows = []
        for frame in islice(frames_of(name, arguments.root, registry), arguments.most):
            row = known.get((name, frame.name)) or {"set": name, **measured(frame, options)}
            if arguments.out and (name, frame.name) not in known:
                with arguments.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
            rows.append(row)
        print(table_row(name, rows), flush=True)


def table_row(name: str, rows: list[dict[str, Any]]) -> str:
    """Return a row of the table: frames, refused, then `matches` alone and refined: successes and median errors."""

    def within(key: str, deg: float, metres: float) -> int:
        return sum(1 for row in rows if (value := row.get(key)) and value[0] <= deg and value[1] <= metres)

    def columns(key: str) -> list[str]:
        errors = np.array([row[key] for row in rows if row.get(key)])
        median = f"{np.median(errors[:, 0]):.2f}, {100 * np.median(errors[:, 1]):.0f}" if len(errors) else ""
        return [f"{within(key, 1.0, 0.3)}", f"{within(key, 3.0, 0.5)}", median]

    if all(row["reason"] == "no intensity" for row in rows):
        return f"| {name} | {len(rows)} | no intensities |" + " |" * 7
    refused = sum("matches" not in row for row in rows)
    trusted = [row["refined"] for row in rows if row.get("trusted")]
    wrong = sum(deg > 1.0 or metres > 0.3 for deg, metres in trusted)
    cells = [name, f"{len(rows)}", f"{refused}", *columns("matches"), *columns("refined"), f"{len(trusted)}, {wrong}"]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
