"""Wrong starts that somebody wrote down: a list of errors, one a frame, as some publications give it."""

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
    "6 numbers a line (rotation vector in rad, then translation in m, of the logarithm), or a matrix of 12 or 16; "
    "the name of its frame may stand before them"
)
_WIDTHS = (6, 12, 16)
_WORDS = re.compile(r"(?:(camera)\s+)?@(.*)", re.DOTALL)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)", re.ASCII | re.IGNORECASE)
_MOST_TEXT = 24
"""So much of a word that is no number is shown."""


@dataclass(frozen=True)
class StartList:
    """Starts from a file of errors T_e: truth @ T_e, or T_e @ truth with `in_camera`."""

    path: str
    in_camera: bool = False

    def __str__(self) -> str:
        return "camera " * self.in_camera + f"@{self.path}"

    def start(self, truth: Float, error: Float) -> Float:
        """Return the start (4, 4) of a truth (4, 4) and the error T_e (4, 4) that the list holds."""
        return np.asarray(error @ truth if self.in_camera else truth @ error)

    def errors(self, names: Sequence[str], indices: Sequence[int]) -> dict[int, Float]:
        """Return T_e (4, 4) of the frames `indices` of a dataset whose frames are called `names`, by index.

        Lines with names belong to the frame of that name, or to the one whose name ends in "/" and theirs. The n-th
        line without a name belongs to the n-th frame, counted from 0: where all names are of one sequence and end in
        numbers ("00/000093") the number counts, whichever frames are there. Other frames are counted as they come,
        which frames of several sequences have to be from their 0 on without gaps.

        Raises InputError naming file and line where the file is missing or cannot be read as such a list, or where a
        frame has no line, or not one of its own.
        """
        path = expanded(self.path)
        by_name, found, lines = _parsed(read_text(path, _WHAT), str(path))
        if by_name:
            numbers = {index: _named(by_name, names[index], path) for index in indices}
        else:
            counted = _counted(names, path)
            numbers = {index: counted[index] for index in indices}
        for index, number in numbers.items():
            if number >= len(found):
                raise InputError(
                    "the list of starts is too short",
                    where=path,
                    expected=f"{number + 1} starts, the last for frame {names[index]}",
                    got=len(found),
                    hint="lines may begin with the names of their frames",
                )
        owner: dict[int, str] = {}
        for index, number in numbers.items():
            if owner.setdefault(number, names[index]) != names[index]:
                raise InputError(
                    f"frames {owner[number]} and {names[index]} take the same start",
                    where=f"{path}, line {lines[number]}",
                    expected="a line for each, beginning with its name",
                )
        return {index: found[number] for index, number in numbers.items()}


def parse_starts(text: str, where: str = "--perturb") -> Perturbation | StartList:
    """Return what a text such as "2deg 0.15m", "@FILE" or "camera @FILE" states; no file is read.

    Raises InputError, naming `where`, for anything else, as `parse_perturbation`.
    """
    match = _WORDS.fullmatch(text.strip())
    if match is None:
        return parse_perturbation(text, where)
    if not match[2].strip():
        raise InputError("there is no file of starts", where=where, expected='"@FILE" or "camera @FILE"', got=text)
    return StartList(match[2].strip(), in_camera=match[1] is not None)


@lru_cache(maxsize=2)
def _parsed(text: str, path: str) -> tuple[Mapping[str, int], Float, tuple[int, ...]]:
    """Return the place of each name (empty where lines have none), the errors (N, 4, 4) and their numbers of line."""
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
            raise InputError("a start has another form", where=place, expected=_LINE, got=f"{len(fields)} words")
        if form not in (None, (len(fields), named)):
            raise InputError(
                "a start has another form than those before",
                where=place,
                expected=f"{form[0]} words" if form else None,
                got=len(fields),
            )
        form = len(fields), named
        if named:
            if fields[0] in by_name:
                raise InputError("a frame has two starts", where=place, got=repr(fields[0]))
            by_name[fields[0]] = len(rows)
        rows.append([_number(field, place) for field in fields[named:]])
        lines.append(number)
    if not rows:
        raise InputError(f"the {_WHAT} holds none", where=path, expected=_LINE)
    return by_name, _errors(np.array(rows), lines, path), tuple(lines)


def _check_columns(fields: Sequence[str], place: str) -> None:
    """Raise InputError for a heading that says that translations come first, as those of some authors' lists do."""
    columns = [field.lower() for field in fields[-6:]]
    if len(columns) == 6 and all(column.startswith("t") for column in columns[:3]):
        raise InputError(
            "the columns of starts are in another order",
            where=place,
            expected=_LINE,
            got=" ".join(fields)[:80],
            hint="angles of Euler and translations that come first are not read: write matrices",
        )


def _number(field: str, place: str) -> float:
    value = float(field) if _NUMBER.fullmatch(field) else np.nan
    if not np.isfinite(value):
        got = repr(field[:_MOST_TEXT])
        raise InputError("a start is not made of finite numbers", where=place, expected=_LINE, got=got)
    return value


def _errors(rows: Float, lines: Sequence[int], path: str) -> Float:
    """Return the transforms (N, 4, 4) of rows (N, 6), (N, 12) or (N, 16)."""
    if rows.shape[1] == 6:
        angle = np.linalg.norm(rows[:, :3], axis=1)
        for row in np.flatnonzero(~(angle <= np.pi + 1e-6))[:1]:
            raise InputError(
                "the rotation of a start is too large",
                where=f"{path}, line {lines[row]}",
                expected="a rotation vector of at most pi rad",
                got=f"{angle[row]:g} rad",
                hint="the rotation comes first, in radians",
            )
        _check_near(rows[:, 3:], lines, path)
        return se3.exp(rows)
    matrices = np.zeros((len(rows), 4, 4))
    matrices[:, 3, 3] = 1.0
    matrices[:, : rows.shape[1] // 4] = rows.reshape(len(rows), -1, 4)
    out = np.stack(
        [
            se3.check_rigid("the start", matrix, where=f"{path}, line {line}")
            for matrix, line in zip(matrices, lines, strict=True)
        ]
    )
    _check_near(out[:, :3, 3], lines, path)
    return out


def _check_near(shift_m: Float, lines: Sequence[int], path: str) -> None:
    """Raise InputError for a translation (N, 3) that is longer than --perturb takes."""
    length = np.abs(shift_m).max(axis=1)
    for row in np.flatnonzero(~(length <= FARTHEST_M))[:1]:
        raise InputError(
            "the translation of a start is too long",
            where=f"{path}, line {lines[row]}",
            expected=f"at most {FARTHEST_M:g} m along each axis",
            got=f"{length[row]:g}",
        )


def _named(by_name: Mapping[str, int], name: str, path: Path) -> int:
    """Return the place of the start of a frame: of its name, or of the longest end of it after a "/"."""
    parts = name.split("/")
    for first in range(len(parts)):
        number = by_name.get("/".join(parts[first:]))
        if number is not None:
            return number
    raise InputError(f"frame {name} has no start in the list", where=path, got=f"names such as {next(iter(by_name))}")


def _counted(names: Sequence[str], path: Path) -> list[int]:
    """Return the place in a list without names of every frame of a dataset."""
    heads, tails = zip(*(name.rpartition("/")[::2] for name in names), strict=True) if names else ((), ())
    if not all(re.fullmatch(r"[0-9]{1,18}", tail) for tail in tails):
        return list(range(len(names)))
    numbers = [int(tail) for tail in tails]
    if len(set(heads)) <= 1:
        return numbers
    seen: dict[str, int] = {}
    for head, number, name in zip(heads, numbers, names, strict=True):
        if number != seen.get(head, 0):
            raise InputError(
                "which line is whose? the frames are of several sequences that have gaps",
                where=path,
                expected="lines that begin with names of frames, or frames of one sequence",
                got=f"frame {name} after {seen.get(head, 0)} of its sequence",
            )
        seen[head] = number + 1
    return list(range(len(names)))
