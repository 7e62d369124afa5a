"""Errors of methods over the number of frames or over the initial error: lines of tables that are of one method."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import Literal

import numpy as np

from p2o_study.statistics import Statistics

Over = Literal["frames", "initial error"]


def frames_of(line: Statistics) -> int:
    """Return the number of frames of a calibration of a line; the last group of frames may be smaller."""
    return max(len(row.frames) for row in line.rows)


def start_error_of(line: Statistics, norm: str) -> float:
    """Return the mean initial error of a line in one of `NORMS`, NaN if it is unknown."""
    known = [error for row in line.rows if (error := row.start_error_of(norm)) is not None]
    return float(np.mean(known)) if known else float("nan")


def curves(lines: Sequence[Statistics], over: Over, *, least: int = 1) -> dict[str, list[Statistics]]:
    """Return the lines of each method in ascending order of what they differ in, with at least this number of them.

    Lines of one curve are of one data set, from one initial error (or with one number of frames); where lines differ in
    these, too, the name of the curve states it. Lines that differ in anything else are no curve.
    """

    def place(line: Statistics) -> float:
        return frames_of(line) if over == "frames" else start_error_of(line, "rotation_deg")

    known = [line for line in lines if line.rows]
    names = method_names(known)
    by_key: dict[tuple[str, str, str], list[Statistics]] = {}
    for line, name in zip(known, names, strict=True):
        size = f", {frames_of(line)} frames"
        fixed = f" from {line.rows[0].case.protocol}" if over == "frames" else size
        key = name.removesuffix(size), f" @ {line.rows[0].dataset}", fixed
        by_key.setdefault(key, []).append(line)
    by_key = {key: own for key, own in by_key.items() if len(set(map(place, own))) == len(own) >= least}
    differ = [len({key[number] for key in by_key}) > 1 for number in (1, 2)]
    return {
        name + dataset * differ[0] + fixed * differ[1]: sorted(own, key=place)
        for (name, dataset, fixed), own in by_key.items()
    }


def method_names(lines: Sequence[Statistics]) -> list[str]:
    """Return the method of each line: what its labels have in common, whatever initial error and number of frames."""
    methods = [_method(line) for line in lines]
    labels: dict[str, list[str]] = {}
    for method, line in zip(methods, lines, strict=True):
        labels.setdefault(method, []).append(line.label)
    return [common_name(labels[method]) for method in methods]


def _method(line: Statistics) -> str:
    """Return a text that is equal for two lines of one method on one kind of data."""
    row = line.rows[-1]
    if row.method.external:
        return f"external {row.row}"
    options = {
        stage: {name: value for name, value in values.items() if name != "seed"}
        if isinstance(values, Mapping)
        else values
        for stage, values in row.method.options.items()
    }
    return json.dumps([row.method.words, options, row.case.options], sort_keys=True, default=str)


def common_name(labels: Sequence[str]) -> str:
    """Return the common beginning of labels in whole words: "ours" of "ours from 1deg" and "ours from 2deg"."""
    if len(set(labels)) == 1:
        return labels[0]
    words = [[word.rstrip(",") for word in label.split(" ")] for label in labels]
    # All labels contain what the first and the last one in alphabetical order have in common.
    pairs = zip(min(words), max(words), strict=False)
    common = [first for first, _ in takewhile(lambda pair: pair[0] == pair[1], pairs)]
    while common and common[-1] in ("", "from", "on", "@"):
        common = common[:-1]
    return " ".join(labels[0].split(" ")[: len(common)]).rstrip(",") or labels[0]
