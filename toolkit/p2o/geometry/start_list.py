"""Lists of errors of initial guesses, one per frame, as published by some authors."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import expanded, read_text
from p2o.geometry import se3
from p2o.geometry.perturb import FARTHEST_M, Perturbation, parse_perturbation

_WHAT = "list of starts"
_LINE = (
    "6 numbers per line (rotation vector in rad, then translation in m, of the logarithm), or a matrix of 12 or 16; "
    "optionally after the name of the frame"
)
_WIDTHS = (6, 12, 16)
_WORDS = re.compile(r"(?:(camera)\s+)?@(.*)", re.DOTALL)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)", re.ASCII | re.IGNORECASE)
_MOST_TEXT = 24
"""Maximum length of an invalid word in errors."""


@dataclass(frozen=True)
class StartList:
    """Initial guesses from a file of errors T_e: truth @ T_e, or T_e @ truth with `in_camera`."""

    path: str
    in_camera: bool = False

    def __str__(self) -> str:
        return "camera " * self.in_camera + f"@{self.path}"

    def start(self, truth: Float, error: Float) -> Float:
        """Return the initial guess (4, 4) of a truth (4, 4) and an error T_e (4, 4)."""
        return np.asarray(error @ truth if self.in_camera else truth @ error)

    def errors(self, names: Sequence[str], indices: Sequence[int]) -> dict[int, Float]:
        """Return T_e (4, 4) of the frames `indices` of a dataset with frames `names`, by index.

        A line with a name belongs to the frame of that name, or to the one whose name ends in "/" and this name. The
        n-th line without a name, counted from 0, belongs to frame n. If all names are of one sequence and end in
        numbers ("00/000093"), n is this number; otherwise n is the index in the dataset, and the numbers of each
        sequence have to begin at 0 without gaps. Raises InputError with file and line if the file is missing or
        invalid, or a frame has no line or shares it.
        """
        path = expanded(self.path)
        by_name, transforms, lines = _parsed(read_text(path, _WHAT), str(path))
        if by_name:
            numbers = {index: _named(by_name, names[index], path) for index in indices}
        else:
            counted = _counted(names, path)
            numbers = {index: counted[index] for index in indices}
        for index, number in numbers.items():
            if number >= len(transforms):
                text = "the list of starts is too short"
                expected = f"{number + 1} starts, the last for frame {names[index]}"
                hint = "lines may begin with the name of the frame"
                raise InputError(text, where=path, expected=expected, got=len(transforms), hint=hint)
        owner: dict[int, str] = {}
        for index, number in numbers.items():
            if owner.setdefault(number, names[index]) != names[index]:
                text = f"frames {owner[number]} and {names[index]} use the same line"
                expected = "a line for each frame, beginning with its name"
                raise InputError(text, where=f"{path}, line {lines[number]}", expected=expected)
        return {index: transforms[number] for index, number in numbers.items()}


def parse_starts(text: str, where: str = "--perturb") -> Perturbation | StartList:
    """Parse a text such as "2deg 0.15m", "@FILE" or "camera @FILE" without reading the file.

    Raises InputError, with `where`, for any other text, as `parse_perturbation`.
    """
    match = _WORDS.fullmatch(text.strip())
    if match is None:
        return parse_perturbation(text, where)
    if not match[2].strip():
        message = "the file of the list of starts is missing"
        raise InputError(message, where=where, expected='"@FILE" or "camera @FILE"', got=text)
    return StartList(match[2].strip(), in_camera=match[1] is not None)


@lru_cache(maxsize=2)
def _parsed(text: str, path: str) -> tuple[Mapping[str, int], Float, tuple[int, ...]]:
    """Return the index of each name (empty if lines have none), the errors (N, 4, 4) and their line numbers."""
    by_name: dict[str, int] = {}
    rows: list[list[float]] = []
    lines: list[int] = []
    form: tuple[int, bool] | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        place = f"{path}, line {number}"
        words = line.partition("#")[0].strip().lstrip("\ufeff")
        between = r"[,;]" if re.search("[,;]", words) else r"\s+"
        fields = [field.strip().strip("\"'") for field in re.split(between, words)]
        if not words:
            continue
        if not rows and not any(_NUMBER.fullmatch(field) for field in fields):
            _check_columns(fields, place)
            continue
        named = len(fields) - 1 in _WIDTHS
        if not named and len(fields) not in _WIDTHS:
            raise InputError("a start has an invalid form", where=place, expected=_LINE, got=f"{len(fields)} words")
        if form not in (None, (len(fields), named)):
            message = "a start differs in form from previous ones"
            raise InputError(message, where=place, expected=f"{form[0]} words" if form else None, got=len(fields))
        form = len(fields), named
        if named:
            if fields[0] in by_name:
                raise InputError("a frame has two starts", where=place, got=repr(fields[0]))
            by_name[fields[0]] = len(rows)
        rows.append([_number(field, place) for field in fields[named:]])
        lines.append(number)
    if not rows:
        raise InputError(f"the {_WHAT} is empty", where=path, expected=_LINE)
    return by_name, _errors(np.array(rows), lines, path), tuple(lines)


def _check_columns(fields: Sequence[str], place: str) -> None:
    """Raise InputError for a heading with translations first, as in the lists of some authors."""
    columns = [field.lower() for field in fields[-6:]]
    if len(columns) == 6 and all(column.startswith("t") for column in columns[:3]):
        text = "the columns of starts are in another order"
        hint = "Euler angles and translations before rotations are not supported: write matrices"
        raise InputError(text, where=place, expected=_LINE, got=" ".join(fields)[:80], hint=hint)


def _number(field: str, place: str) -> float:
    value = float(field) if _NUMBER.fullmatch(field) else np.nan
    if not np.isfinite(value):
        got = repr(field[:_MOST_TEXT])
        raise InputError("a start contains a word that is not a finite number", where=place, expected=_LINE, got=got)
    return value


def _errors(rows: Float, lines: Sequence[int], path: str) -> Float:
    """Return the transforms (N, 4, 4) of rows (N, 6), (N, 12) or (N, 16)."""
    if rows.shape[1] == 6:
        angle = np.linalg.norm(rows[:, :3], axis=1)
        for row in np.flatnonzero(~(angle <= np.pi + 1e-6))[:1]:
            text, where = "the rotation of a start is too large", f"{path}, line {lines[row]}"
            expected = "a rotation vector of at most pi rad"
            hint = "the rotation comes first, in radians: multiply degrees by pi/180"
            raise InputError(text, where=where, expected=expected, got=f"{angle[row]:g} rad", hint=hint)
        _check_near(rows[:, 3:], lines, path)
        return se3.exp(rows)
    matrices = np.zeros((len(rows), 4, 4))
    matrices[:, 3, 3] = 1.0
    matrices[:, : rows.shape[1] // 4] = rows.reshape(len(rows), -1, 4)
    places = [f"{path}, line {line}" for line in lines]
    checked = [se3.check_rigid("the start", m, where=place) for m, place in zip(matrices, places, strict=True)]
    out = np.stack(checked)
    _check_near(out[:, :3, 3], lines, path)
    return out


def _check_near(shift_m: Float, lines: Sequence[int], path: str) -> None:
    """Raise InputError for translations (N, 3) above the limit of --perturb."""
    length = np.abs(shift_m).max(axis=1)
    for row in np.flatnonzero(~(length <= FARTHEST_M))[:1]:
        text, expected = "the translation of a start is too long", f"at most {FARTHEST_M:g} m along each axis"
        where, hint = f"{path}, line {lines[row]}", "if it is in millimetres, divide it by 1000"
        raise InputError(text, where=where, expected=expected, got=f"{length[row]:g}", hint=hint)


def _named(by_name: Mapping[str, int], name: str, path: Path) -> int:
    """Return the index of the line of a frame, by its name or the longest end of it after a "/"."""
    parts = name.split("/")
    for first in range(len(parts)):
        number = by_name.get("/".join(parts[first:]))
        if number is not None:
            return number
    raise InputError(f"frame {name} has no start in the list", where=path, got=f"names such as {next(iter(by_name))}")


def _counted(names: Sequence[str], path: Path) -> list[int]:
    """Return for every frame of a dataset its index in a list without names."""
    heads, tails = zip(*(name.rpartition("/")[::2] for name in names), strict=True) if names else ((), ())
    if not all(re.fullmatch(r"[0-9]{1,18}", tail) for tail in tails):
        return list(range(len(names)))
    numbers = [int(tail) for tail in tails]
    if len(set(heads)) <= 1:
        return numbers
    used: dict[str, int] = {}
    for head, number, name in zip(heads, numbers, names, strict=True):
        if number != used.get(head, 0):
            text = "the lines cannot be assigned to frames of several sequences with gaps"
            expected = "lines with names of frames, or frames of one sequence"
            got = f"frame {name} after {used.get(head, 0)} of its sequence"
            raise InputError(text, where=path, expected=expected, got=got)
        used[head] = number + 1
    return list(range(len(names)))
