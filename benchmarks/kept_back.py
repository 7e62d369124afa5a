"""Print the table of results on frames that were kept back from development, as measured by others.

    python benchmarks/kept_back.py FILE.md
    python benchmarks/kept_back.py FILE.md --beside rigs    # free weights, beside development frames of the same rigs
    python benchmarks/kept_back.py FILE.md --brief    # free weights, one line for each set of SETS

FILE has a Markdown table with the columns set, weights and mode, as `kept-back-0.2.0.md`. Figures of development frames
are from the rows of a suite with this version.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from limits_and_tables import table
from p2o.host.registry import Registry
from p2o_study.benchmark.lines import Key, read_lines
from p2o_study.benchmark.suite import find_suite
from p2o_study.rows import Rows
from p2o_study.statistics import Statistics

DEVELOPMENT = {
    "odometry 00, later half": "odometry00",
    "raw 2011_09_26, other drives": "kitti-raw",
    "raw, unseen drive": "kitti-raw",
    "waymo, later part": "waymo",
    "hitsz, 16 rings": "hitsz",
}
"""The data set of the suite with development frames of the rig of a set; other sets have none."""
LABEL = "default"
"""The label of single frames in the suite; that of joint calibrations ends with ", joint"."""
COLUMNS = ("runs (frames)", "deg median", "deg mean", "cm median", "cm mean", "trusted", "trusted, outside 95 %")

SHORT = {"single": "one frame (deg, cm)", "joint": "all jointly"}
"""Headings of `by_set` by mode."""
WRONG = "trusted, > 1 deg or 30 cm"
SETS = (
    "odometry 00, later half",
    "raw 2011_09_26, other drives",
    "waymo, later part",
    "drive 0052, 32 rings",
    "drive 0052, 16 rings",
    "tamu, OS1-64 indoors at rest",
)
"""Sets of `by_set`: those with single frames and joint calibrations, one for each kind of sensor and place."""


def read(text: str) -> list[dict[str, str]]:
    """Return the rows of the table in `text`, by heading."""
    lines = [line.strip().strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    head, _, *rows = ([cell.strip() for cell in line] for line in lines)
    return [dict(zip(head, row, strict=True)) for row in rows]


def development(line: Statistics | None) -> list[str]:
    """Return the cells of `COLUMNS` of a row of a suite, "-" without one."""
    if line is None:
        return ["-"] * len(COLUMNS)
    errors = []
    for norm, factor, digits in (("rotation_deg", 1, 3), ("translation_m", 100, 1)):
        median, mean = line.median(norm), line.mean(norm)
        errors += [f"{factor * one.value:.{digits}f}" if one is not None else "-" for one in (median, mean)]
    return [f"{line.count} ({line.frames})", *errors, str(line.trusted), str(line.outside_95.runs)]


def beside(rows: list[dict[str, str]], lines: dict[Key, Statistics]) -> str:
    """Return the kept-back figures of sets after those of development frames of the same rig."""
    by_label = {(key.dataset, key.label.removeprefix("without-rings ")): line for key, line in lines.items()}
    cells = []
    for row in rows:
        label = LABEL + (", joint" if row["mode"] == "joint" else "")
        line = by_label.get((DEVELOPMENT.get(row["set"], ""), label))
        cells.append([row["set"], row["mode"], *development(line), *(row[name] for name in COLUMNS)])
    return table(["set", "mode", *COLUMNS, *(f"kept back: {name}" for name in COLUMNS)], cells)


def by_set(rows: list[dict[str, str]]) -> str:
    """Return one line for each of `SETS`: medians of single frames and of joint calibrations, and their verdicts."""
    cells = []
    for name in SETS:
        modes = {row["mode"]: row for row in rows if row["set"] == name}
        errors = [f"{row['deg median']}, {row['cm median']}" for row in (modes[mode] for mode in SHORT)]
        runs = sum(int(row["runs (frames)"].split()[0]) for row in modes.values())
        trusted, wrong = (sum(int(row[key]) for row in modes.values()) for key in ("trusted", WRONG))
        frames = modes["single"]["runs (frames)"].split("(")[1].rstrip(")")
        cells.append([name, frames, *errors, f"{trusted} of {runs} ({wrong})"])
    return table(["frames of", "number", *SHORT.values(), "trusted (wrong)"], cells)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("file", type=Path)
    parser.add_argument("--brief", action="store_true", help="one line for each set of SETS")
    parser.add_argument("--beside", metavar="SUITE", help="a suite of single frames and joint calibrations")
    parser.add_argument("--results", default="benchmarks/results")
    given = parser.parse_args()
    rows = read(given.file.read_text(encoding="utf-8"))
    free = [row for row in rows if row["weights"] == "free"]
    if given.brief:
        print(by_set(free))
    elif given.beside is None:
        print(table(list(rows[0]), [list(row.values()) for row in rows]))
    else:
        print(beside(free, read_lines(find_suite(given.beside, Registry.load()), Rows(given.results))))


if __name__ == "__main__":
    main()
