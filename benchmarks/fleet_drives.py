"""A fleet of real and simulated drives, some with a slip from a known drive on: `python benchmarks/fleet.py real`.

Drives are pieces of eight frames or more, fewer where a drive is shorter: of drive 0005 and of the drives of KITTI's
split `train`, once consecutive and once spread, of odometry 00, of the development parts of other rigs, and of
simulated drives with an HDL-64E. A vehicle is a list of drives, one a day. Vehicles whose name begins with `slip` have
spread pieces of the others; from the ninth drive on, a sensor has moved on one axis (`slipped_drives.py`).
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

import numpy as np
from limits_and_tables import SPLITS, size, table
from p2o.confidence.audit import AXES
from p2o.confidence.explanation import corrected
from p2o.errors import InputError
from p2o.geometry.pose_error import pose_error
from p2o_fleet.fleet_state import Alarm, ExtrinsicState, FleetState, FleetStatus, amount, fleet_state
from p2o_fleet.store import Store

FRAMES, BEFORE, DRIVES = 8, 8, 16
"""Number of frames of a check, of drives of a vehicle before its slip, and of all drives of a vehicle with a slip."""
_BEGIN, _DAY_S = 1767225600, 86400
_SIMULATED = {"sim-a": 21, "sim-b": 22}
_SCENES = 80
_SIZES = {"deg": 0.5, "m": 0.05}
_PLUGIN = Path(__file__).with_name("slipped_drives.py")
COLUMNS = ("vehicle", "vehicle_type", "camera", "lidar", "data", "extrinsic", "time", "frames")


@dataclass(frozen=True)
class Piece:
    """A drive: the data set and the folder of its data, and its frames."""

    dataset: str
    path: Path
    frames: str

    def data(self, slip: tuple[int, float] | None) -> str:
        """Return the text of the data; `slip` is the axis and the size of an error of the extrinsic."""
        if slip is None:
            return f"{self.dataset}:{self.path}"
        return f"slipped:{self.path}?of={self.dataset}&axis={AXES[slip[0]][0]}&size={slip[1]:g}"


@dataclass(frozen=True)
class Vehicle:
    """A vehicle with its drives; `slip` is the axis and the size of its error from drive `BEFORE` on."""

    name: str
    type: str
    drives: tuple[Piece, ...]
    camera: str = "front"
    slip: tuple[int, float] | None = None

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield the rows of the table of drives."""
        for number, piece in enumerate(self.drives):
            data = piece.data(self.slip if number >= BEFORE else None)
            time = str(_BEGIN + number * _DAY_S)
            yield self.name, self.type, self.camera, "top", data, "truth", time, piece.frames


def consecutive(names: Sequence[str]) -> list[list[str]]:
    """Split frames into consecutive pieces of `FRAMES` or more."""
    return [part.tolist() for part in np.array_split(np.array(names), max(1, len(names) // FRAMES))]


def spread_out(names: Sequence[str]) -> list[list[str]]:
    """Split frames into pieces of `FRAMES` or more, whose frames are as far apart as possible."""
    count = max(1, len(names) // FRAMES)
    return [list(names[first::count]) for first in range(count)]


def _shuffled(parts: list[list[str]], seed: int = 0) -> list[list[str]]:
    return [parts[at] for at in np.random.default_rng(seed).permutation(len(parts))]


def vehicles(root: Path, splits: Mapping[str, Sequence[str]], simulated: Path) -> list[Vehicle]:
    """Return the fleet."""
    raw = root / "kitti_raw"
    by_drive: dict[str, list[str]] = {}
    for name in splits["train"]:
        by_drive.setdefault(name.rpartition("/")[0], []).append(name)
    later = splits["drive_0005_later"]
    first = [name for name in splits["drive_0005_consecutive"] if name not in splits["test"]]
    between = [name for name in splits["drive_0005_sparse"] if name not in {*first, *later}]
    near = _shuffled([piece for names in (first, later, *by_drive.values()) for piece in consecutive(names)])
    far = _shuffled([piece for names in ([*first, *between], later, splits["train"]) for piece in spread_out(names)])
    kitti = {f"kitti-{n + 1}": _pieces("kitti-raw", raw, near[n::3]) for n in range(3)}
    kitti |= {f"kitti-{n + 4}": _pieces("kitti-raw", raw, far[n::3]) for n in range(3)}
    fleet = [Vehicle(name, "kitti", drives) for name, drives in kitti.items()]
    scenes = [f"scene-{number:04d}" for number in range(_SCENES)]
    parts = [*consecutive(scenes), *spread_out(scenes)]
    sims = {
        name: _pieces("folder", simulated / name, _shuffled(parts, seed)[:DRIVES]) for name, seed in _SIMULATED.items()
    }
    fleet += [Vehicle(name, "sim-hdl-64e", drives) for name, drives in sims.items()]
    for axis, (name, unit) in enumerate(AXES):
        slip = axis, _SIZES[unit] * (1 if axis % 2 == 0 else -1)
        parts = _shuffled(far, seed=1 + axis)[:DRIVES]
        fleet.append(Vehicle(f"slip-{name}", "kitti", _pieces("kitti-raw", raw, parts), slip=slip))
    fleet.append(Vehicle("slip-sim-yaw", "sim-hdl-64e", sims["sim-a"][::-1], slip=(2, -_SIZES["deg"])))
    fleet.append(Vehicle("slip-sim-y", "sim-hdl-64e", sims["sim-b"][::-1], slip=(4, _SIZES["m"])))
    return fleet + _other_rigs(root, splits)


def _other_rigs(root: Path, splits: Mapping[str, Sequence[str]]) -> list[Vehicle]:
    odometry = _pieces("kitti-odometry", root / "kitti_odometry", consecutive(splits["odometry00-dev"]))
    fleet = [Vehicle("odometry-00", "kitti-odometry", odometry)]
    for rig in ("waymo", "hitsz", "acfr_vlp16", "boards_sim"):
        drives = _pieces("folder", root / "rigs" / rig, consecutive(splits[f"{rig}-dev"]))
        fleet.append(Vehicle(rig, rig, drives))
    for number, names in enumerate((splits["pjlab-dev"][:2], splits["pjlab-dev"][2:])):  # images of two vehicles
        fleet.append(Vehicle(f"pjlab-{number + 1}", "pjlab", _pieces("folder", root / "rigs" / "pjlab", [names])))
    for camera in splits["nuscenes-dev"]:
        drives = _pieces("folder", root / "rigs" / "nuscenes", [[camera]])
        fleet.append(Vehicle("nuscenes", "nuscenes", drives, camera))
    return fleet


def _pieces(dataset: str, path: Path, parts: Sequence[Sequence[str]]) -> tuple[Piece, ...]:
    return tuple(Piece(dataset, path, ",".join(names)) for names in parts)


def real(root: Path, out: Path) -> Iterator[str]:
    """Run `p2o fleet run` and `p2o fleet report` on the fleet, and yield the results as tables.

    Everything is written to `out`; what is stored there from an earlier call is kept.
    """
    import pyarrow.dataset

    for name, seed in _SIMULATED.items():
        if not (out / "simulated" / name).exists():
            settings = ["right=false", f"scenes={_SCENES}", "lidar=hdl-64e", "width_px=800", "height_px=300"]
            words = [word for setting in settings for word in ("--set", setting)]
            _p2o("simulate", str(out / "simulated" / name), "--layout", "folder", "--seed", str(seed), *words)
    fleet = vehicles(root, json.loads(SPLITS.read_text(encoding="utf-8")), out / "simulated")
    drives, store, report = out / "drives.csv", ("--store", str(out / "store")), out / "report"
    with drives.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *(row for vehicle in fleet for row in vehicle.rows())])
    plugin = ("--plugin", str(_PLUGIN))
    _p2o("fleet", "run", str(drives), *store, "--frames", str(FRAMES), "--candidates", str(FRAMES), *plugin)
    _p2o("fleet", "report", *store, "--out", str(report), allowed=(0, 1))
    alarms = {alarm["vehicle"] for alarm in json.loads((report / "fleet.json").read_text(encoding="utf-8"))["alarms"]}
    state = fleet_state(Store.existing(out / "store"))
    if alarms != {alarm.vehicle for alarm in state.alarms}:
        raise InputError("the report is not that of the store", where=report, expected="the same alarms", got=alarms)
    yield _overview(fleet, state)
    yield _slips(fleet, state)
    means = [
        (kind.vehicle_type, kind.vehicles, *(amount(error).partition(" ")[2] for error in kind.errors))
        for kind in state.types
        if kind.errors
    ]
    yield table(("mean error of", "vehicles", *(name for name, _ in AXES)), means)
    stored = pyarrow.dataset.dataset(Store(out / "store").checks_folder, format="parquet")
    seconds = np.array(stored.to_table(columns=["seconds"])["seconds"].to_pylist())
    figures = [f"{value:.0f}" for value in (seconds.sum(), *np.quantile(seconds, [0.5, 0.95, 1.0]))]
    yield table(("checks", "s in total", "median", "95 %", "longest"), [(len(seconds), *figures)])


def _p2o(*words: str, allowed: Sequence[int] = (0,)) -> None:
    done = subprocess.run([sys.executable, "-m", "p2o", *words], stdout=subprocess.DEVNULL, check=False)
    if done.returncode not in allowed:
        raise InputError("the command failed", where=" ".join(words), expected="exit status 0", got=done.returncode)


_ORDER = (FleetStatus.HOLDS, FleetStatus.SLIPPED, FleetStatus.WRONG, FleetStatus.CANNOT_TELL)


def _overview(fleet: Sequence[Vehicle], state: FleetState) -> str:
    """Return drives, frames and states of the extrinsics in use by type, with and without a slip."""
    lines = []
    for kind in dict.fromkeys(vehicle.type for vehicle in fleet):
        for slip in (False, True):
            own = {v.name for v in fleet if v.type == kind and (v.slip is not None) is slip}
            states = [extrinsic for extrinsic in state.current if extrinsic.vehicle in own]
            if states:
                drives, usable, frames = (sum(map(attrgetter(n), states)) for n in ("checks", "usable", "frames"))
                counts = [sum(extrinsic.status is status for extrinsic in states) for status in _ORDER]
                lines.append((kind, "yes" if slip else "no", len(states), drives, frames, drives - usable, *counts))
    head = ("type", "slip", "extrinsics", "drives", "frames", "no estimate", "holds", "slipped", "wrong", "cannot tell")
    return table(head, lines)


def _slips(fleet: Sequence[Vehicle], state: FleetState) -> str:
    """Return what the report states on each vehicle with a slip or an alarm."""
    lines = []
    for vehicle in fleet:
        current = next(s for s in state.current if (s.vehicle, s.camera) == (vehicle.name, vehicle.camera))
        slip, alarm = vehicle.slip, current.alarm
        if slip is None and alarm is None:
            continue
        injected, cells = "none", ["none", "", "", ""]
        if slip is not None:
            (name, unit), value = AXES[slip[0]], slip[1]
            value_text = f"{value:+g} deg" if unit == "deg" else f"{100 * value:+g} cm"
            injected = f"{name} {value_text} since drive {BEFORE + 1}"
        if alarm is not None:
            first = [_drive_number(time) for time in (alarm.since, alarm.since_first, alarm.since_last)]
            cells[:2] = [", ".join(map(amount, alarm.axes)), "{} ({} to {})".format(*first)]
        if alarm is not None and slip is not None:
            cells[2:] = [_delay(current, len(state.current), state.rules.rate), _proposed(alarm, slip)]
        lines.append((vehicle.name, injected, *cells))
    head = ("slip", "alarm (95 %)", "since drive (95 %)", "drives, frames until alarm", "error of proposal")
    return table(("vehicle", *head), lines)


def _drive_number(time: float) -> int:
    return 1 + round((time - _BEGIN) / _DAY_S)


def _delay(extrinsic: ExtrinsicState, count: int, rate: float) -> str:
    """Return the drives and frames after the slip until the evidence alone is a discovery among `count` extrinsics."""
    past = extrinsic.history
    after = [log_e for time, log_e in zip(past.time, past.log_e, strict=True) if _drive_number(time) > BEFORE]
    enough = np.flatnonzero(np.array(after) >= np.log(count / rate))
    return f"{enough[0] + 1}, {(enough[0] + 1) * FRAMES}" if len(enough) else "with others only"


def _proposed(alarm: Alarm, slip: tuple[int, float]) -> str:
    """Return the error of the proposed extrinsic; the correct one is that in use without the slip."""
    names = [name for name, _ in AXES]
    in_use = alarm.proposal  # with the errors of the alarm
    for axis in reversed(alarm.axes):
        in_use = corrected(in_use, names.index(axis.axis), np.array([-axis.size]))[0]
    error = pose_error(alarm.proposal, corrected(in_use, slip[0], np.array([slip[1]]))[0])
    return size(error.rotation_deg, error.translation_m)
