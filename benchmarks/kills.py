"""A study that is killed at random moments, again and again: is a finished row lost, or one bit of a result changed?

    python benchmarks/kills.py --kills 100 --seed 1

A small study of synthetic streets is run undisturbed once. Then it is started, killed at a random moment and started
again until it is done, and once more in another folder, until it was killed so often: by SIGKILL, SIGTERM and SIGINT,
the process alone or all processes of its group, with one job and with two. After every kill the store is whole, every
row that was seen before is there, and no process is left; what SIGTERM and SIGINT end has status 130, unless Python has
not come to p2o yet. Every row is the same to the last bit as that of the undisturbed study, but for the time it took.
Exit status 1 where one of these does not hold. The seed gives the same moments again, as far as the machine is as fast.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

STUDY = """name = "kills"
title = "A study that is killed"
perturb = "1deg 0.05m"
seeds = {seeds}
[[dataset]]
name = "streets"
data = "synthetic:"
options = {{ scenes = {scenes}, width_px = 320, height_px = 96, lidar = "vlp-16", right = false }}
[defaults]
extractor = "depth/rings"
init = "given"
solver = "lm"
[[product]]
matcher = ["ogm", "nearest"]
[[row]]
label = "pairs of frames"
matcher = "ogm"
joint = 2
"""
_TAKES_TIME = {"seconds", "finished", "machine"}
"""Columns that differ from run to run."""
_SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_LEAVE_S = 30.0
"""So long the processes of a killed study may take to end on a busy machine; workers look every half second."""

Row = tuple[object, ...]


@dataclass
class Tally:
    """What came of it: `kills` by signal, how many of them fell among the rows, and every broken promise."""

    kills: Counter[str] = field(default_factory=Counter)
    among_rows: int = 0
    studies: int = 0
    rows: int = 0
    broken: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        how = ", ".join(f"{count} by {name}" for name, count in sorted(self.kills.items()))
        head = (
            f"{self.kills.total()} kills ({how}), {self.among_rows} of them among the rows; {self.studies} studies "
            f"of {self.rows} rows came to their end; {len(self.broken)} conditions violated"
        )
        return "\n".join([head, *(f"  {line}" for line in self.broken)])


@dataclass(frozen=True)
class Pace:
    """How long a study takes to come to its first row, and for every further one."""

    start_s: float
    row_s: float


def campaign(kills: int, seed: int, home: Path, *, scenes: int = 3, seeds: int = 4, report: bool = False) -> Tally:
    """Kill a study of `scenes` frames and `seeds` starts so often, in folders of `home`, and return what came of it."""
    rng, tally = random.Random(seed), Tally()
    file = home / "kills.toml"
    file.write_text(STUDY.format(scenes=scenes, seeds=seeds), encoding="utf-8")
    pace, expected = _undisturbed(file, home / "undisturbed")
    tally.rows = len(expected)
    while tally.kills.total() < kills:
        tally.studies += 1
        jobs = 1 + tally.studies % 2
        folder = home / f"study-{tally.studies}"
        while _disturbed(file, folder, jobs, rng, pace, tally, expected, kills):
            if report:
                now = f"{len(_rows(folder))} of {tally.rows} rows, {len(tally.broken)} conditions violated"
                lines = [f"{tally.kills.total()} kills, {now}", *tally.broken[-1:]]
                print("\n  ".join(lines), file=sys.stderr, flush=True)
        found = _rows(folder)
        if found != expected:
            tally.broken.append(f"{folder.name}: {_difference(found, expected)}")
    return tally


def _disturbed(
    file: Path,
    folder: Path,
    jobs: int,
    rng: random.Random,
    pace: Pace,
    tally: Tally,
    expected: Mapping[str, Row],
    kills: int,
) -> bool:
    """Start a study, kill it, and judge what is left; False where it came to its end."""
    before = _rows(folder)
    number, everyone = rng.choice(_SIGNALS), rng.random() < 0.5
    process = _start(file, folder, jobs)
    # A third of the kills fall into starting, reading and planning, the others among the rows.
    if tally.kills.total() >= kills:
        status: int | None = process.wait()
    elif rng.random() < 1 / 3:
        status = _waited(process, rng.uniform(0.0, pace.start_s))
    else:
        while (status := process.poll()) is None and len(_rows(folder)) == len(before):
            time.sleep(0.02)
        status = _waited(process, rng.uniform(0.0, 4 * pace.row_s))
    where = f"{folder.name}, kill {tally.kills.total() + 1} ({number.name} to {'all' if everyone else 'one'})"
    if status is None:
        there, heeds = _rows(folder), _heeds(process.pid)
        (os.killpg if everyone else os.kill)(process.pid, number)
        status = process.wait(600)
        tally.kills[number.name] += 1
        tally.among_rows += 0 < len(there) < len(expected)
        # Shells say 130 of SIGINT, too: with it Python ends where an interrupt has met a text that it compiled.
        tidy = {-number} if number is signal.SIGKILL or not heeds else {130, -signal.SIGINT}
        if status not in tidy | {0, 130}:
            tally.broken.append(f"{where}: exit status {status}")
    else:
        there = _rows(folder)
        if status:
            tally.broken.append(f"{where}: ended by itself with status {status}")
    left = _left(process.pid)
    if left:
        tally.broken.append(f"{where}: {len(left)} processes are left")
        os.killpg(process.pid, signal.SIGKILL)
    now = _rows(folder)
    lost = [key for key in before.keys() | there.keys() if key not in now]
    changed = [key for key in now if now[key] != expected.get(key)]
    for keys, what in ((lost, "lost"), (changed, "changed")):
        if keys:
            tally.broken.append(f"{where}: {len(keys)} rows {what}, such as {keys[0]}")
    return len(now) < len(expected) and status != 0


def _undisturbed(file: Path, folder: Path) -> tuple[Pace, dict[str, Row]]:
    """Return how long an undisturbed study took to come to its first row and for each more, and its rows."""
    began = time.monotonic()
    process = _start(file, folder, jobs=1)
    while process.poll() is None and not _rows(folder):
        time.sleep(0.02)
    start_s = time.monotonic() - began
    if process.wait():
        raise SystemExit("the undisturbed study did not succeed")
    rows = _rows(folder)
    return Pace(start_s, (time.monotonic() - began - start_s) / len(rows)), rows


def _waited(process: subprocess.Popen[bytes], delay_s: float) -> int | None:
    """Return the status of a process that ends in time, else None."""
    try:
        return process.wait(delay_s)
    except subprocess.TimeoutExpired:
        return None


def _start(file: Path, folder: Path, jobs: int) -> subprocess.Popen[bytes]:
    """Start the study in a session of its own, whose cache is in the folder."""
    command = [sys.executable, "-m", "p2o", "ablate", str(file), "--out", str(folder), "--jobs", str(jobs), "--quiet"]
    environ = {**os.environ, "P2O_CACHE": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    nowhere = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=nowhere, stderr=nowhere, env=environ, start_new_session=True)


def _heeds(process: int) -> bool:
    """Return whether a process is in the part of p2o that handles signals; False if that cannot be determined."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def _rows(folder: Path) -> dict[str, Row]:
    """Return the finished rows of a store by key, without what takes time; raises where the store is damaged."""
    if not (folder / "study.sqlite").exists():
        return {}
    connection = sqlite3.connect(folder / "study.sqlite", timeout=60)
    try:
        if connection.execute("pragma integrity_check").fetchall() != [("ok",)]:
            raise SystemExit(f"{folder}: the store is damaged")
        names = [name for _, name, *_ in connection.execute("pragma table_info(runs)")]
        kept = [name for name in names if name not in _TAKES_TIME]
        query = f"select {', '.join(kept)} from runs where status != 'stage-failed'" if kept else "select 1 where 0"
        return {str(row[0]): row for row in connection.execute(query)}
    finally:
        connection.close()


def _difference(found: Mapping[str, Row], expected: Mapping[str, Row]) -> str:
    keys = [key for key in expected.keys() | found.keys() if found.get(key) != expected.get(key)]
    return f"{len(keys)} rows of {len(expected)} differ in the end, such as {keys[0]}"


def _left(session: int) -> list[str]:
    """Return the processes of a session that do not end; none if they cannot be listed."""
    until = time.monotonic() + _LEAVE_S
    while (alive := _alive(session)) and time.monotonic() < until:
        time.sleep(0.1)
    return alive


def _alive(session: int) -> list[str]:
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, own, *_ = file.read_text().rpartition(")")[2].split()
        except (OSError, ValueError):  # it has ended meanwhile
            continue
        if own == str(session) and state not in "ZX":
            found.append(file.parent.name)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=3, help="frames of the study")
    parser.add_argument("--starts", type=int, default=4, help="starts of each frame")
    parser.add_argument("--quiet", action="store_true", help="the last line only")
    words = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as home:
        tally = campaign(
            words.kills, words.seed, Path(home), scenes=words.scenes, seeds=words.starts, report=not words.quiet
        )
    print(tally)
    return 1 if tally.broken else 0


if __name__ == "__main__":
    sys.exit(main())
