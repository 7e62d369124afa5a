"""A start told in words: which way the LiDAR's axes point, where the camera looks and, where known, where it is."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.perturb import FARTHEST_M

# The frame of the words: x forward, y left, z up, as seen by who drives.
_DIRECTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
_HEADINGS_DEG = {"forward": 0.0, "left": 90.0, "back": 180.0, "right": -90.0}
_TILTS_DEG = {"up": 90.0, "down": -90.0}
_UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}

EXAMPLE = '"roughly x forward, z up; camera looks forward"'
_AXES_FORM = "two axes of x, y, z, each with one of " + ", ".join(_DIRECTIONS) + ': "x forward, z up"'
_LOOK_FORM = (
    'forward, back, left, right or "45 deg left" or right; then, if need be, "10 deg down" or up, and "upside down" or '
    '"turned 90 deg clockwise" or counterclockwise: "camera looks 45 deg left, 10 deg down"'
)
_PLACE_FORM = 'metres with a direction each: "camera 0.3 m forward, 1.2 m down of lidar"'
_NUMBER = r"(\d{1,6}(?:\.\d{1,9})?|\.\d{1,9})"


def rough_start(text: str, where: object = "start") -> Float:
    """Return camera_from_lidar (4, 4) of words such as "roughly x forward, z up; camera looks forward".

    Three clauses are joined by ";", in any order: two of the LiDAR's axes and where they point (the third follows, as
    axes are right-handed); "camera looks" with a heading, a tilt and a turn about the optical axis; and "camera 0.3 m
    forward, 1.2 m down of lidar", without which both are at one place. Forward, left and up are those of the car. The
    heading counts from forward to the left or right, the tilt from the horizon up or down. "Clockwise" is how the
    camera itself is turned, seen from behind: turned by 90 deg, its right side is below. "upside down" is a turn by
    180 deg.

    Raises InputError that says which clause cannot be read and shows one that can.
    """
    words = text.strip().lower()
    head, _, rest = words.partition(" ")
    if head != "roughly":
        raise _unread(text, EXAMPLE, where)
    axes, look, place = None, None, None
    for clause in (part.strip() for part in rest.split(";")):
        if clause.startswith("camera looks"):
            _once(look, clause, where)
            look = _camera_from_car(clause, where)
        elif clause.startswith("camera"):
            _once(place, clause, where)
            place = _camera_place(clause, where)
        else:
            _once(axes, clause, where)
            axes = _car_from_lidar(clause, where)
    if axes is None:
        raise InputError("it is not said how the LiDAR's axes point", where=where, expected=_AXES_FORM, got=text)
    if look is None:
        raise InputError("it is not said where the camera looks", where=where, expected=_LOOK_FORM, got=text)
    return se3.make(look @ axes, np.zeros(3) if place is None else -look @ place)


def _car_from_lidar(clause: str, where: object) -> Float:
    """Return the rotation (3, 3) whose columns are the directions of the LiDAR's axes."""
    columns: dict[int, Float] = {}
    for piece in _pieces(clause.removeprefix("lidar ")):
        axis, _, direction = piece.partition(" ")
        if axis not in ("x", "y", "z") or direction not in _DIRECTIONS or "xyz".index(axis) in columns:
            raise _unread(clause, _AXES_FORM, where)
        columns["xyz".index(axis)] = np.array(_DIRECTIONS[direction])
    if len(columns) not in (2, 3):
        raise _unread(clause, _AXES_FORM, where)
    for third in {0, 1, 2} - columns.keys():
        columns[third] = np.cross(columns[(third + 1) % 3], columns[(third + 2) % 3])
    matrix = np.stack([columns[number] for number in range(3)], axis=1)
    if not np.isclose(np.linalg.det(matrix), 1):
        raise InputError(
            "the LiDAR's axes are not those of a right-handed frame",
            where=where,
            expected="directions at right angles; with x forward and y left z is up",
            got=clause,
        )
    return matrix


def _camera_from_car(clause: str, where: object) -> Float:
    """Return the rotation (3, 3) whose rows are the camera's right, down and forward in the frame of the words."""
    said: dict[str, float] = {}
    for piece in _pieces(clause.removeprefix("camera looks")):
        name, angle_deg = _turn(piece, clause, where)
        if name in said:
            raise _unread(clause, _LOOK_FORM, where)
        said[name] = angle_deg
    cos, sin = {}, {}
    for name in ("heading", "tilt", "roll"):
        angle = np.radians(said.get(name, 0.0))
        # So that quarter turns are exact.
        cos[name], sin[name] = np.round(np.cos(angle), 15), np.round(np.sin(angle), 15)
    ahead = np.array([cos["heading"], sin["heading"], 0.0])
    look = cos["tilt"] * ahead + np.array([0.0, 0.0, sin["tilt"]])
    right = np.array([sin["heading"], -cos["heading"], 0.0])
    down = np.cross(look, right)
    turned_right, turned_down = cos["roll"] * right + sin["roll"] * down, cos["roll"] * down - sin["roll"] * right
    return np.stack([turned_right, turned_down, look]) + 0.0


def _turn(piece: str, clause: str, where: object) -> tuple[str, float]:
    """Return which turn a piece is about, heading, tilt or roll, and by how many degrees."""
    if piece in _HEADINGS_DEG:
        return "heading", _HEADINGS_DEG[piece]
    if piece in _TILTS_DEG:
        return "tilt", _TILTS_DEG[piece]
    if piece == "upside down":
        return "roll", 180.0
    match = re.fullmatch(rf"(turned )?{_NUMBER} ?deg (left|right|up|down|clockwise|counterclockwise)", piece)
    if match is None:
        raise _unread(clause, _LOOK_FORM, where)
    turned, angle_deg, way = match[1] is not None, float(match[2]), match[3]
    name = {"left": "heading", "right": "heading", "up": "tilt", "down": "tilt"}.get(way, "roll")
    if turned != (name == "roll") or angle_deg > (90 if name == "tilt" else 180):
        raise _unread(clause, _LOOK_FORM, where)
    return name, -angle_deg if way in ("right", "down", "counterclockwise") else angle_deg


def _camera_place(clause: str, where: object) -> Float:
    """Return the place (3,) of the camera as seen from the LiDAR, in metres along forward, left and up."""
    match = re.fullmatch(r"camera (.+) of (?:the )?lidar", clause)
    if match is None:
        raise _unread(clause, _PLACE_FORM, where)
    place = np.zeros(3)
    for piece in _pieces(match[1]):
        found = re.fullmatch(rf"{_NUMBER} ?(m|cm|mm) ({'|'.join(_DIRECTIONS)})", piece)
        step = None if found is None else np.array(_DIRECTIONS[found[3]])
        if found is None or step is None or (place * step).any():
            raise _unread(clause, _PLACE_FORM, where)
        length_m = float(found[1]) * _UNITS_M[found[2]]
        if length_m > FARTHEST_M:
            raise InputError("the camera is too far away", where=where, expected=f"at most {FARTHEST_M:g} m", got=piece)
        place += length_m * step
    return place


def _pieces(text: str) -> Sequence[str]:
    return [" ".join(piece.split()) for piece in text.split(",")]


def _once(known: Float | None, clause: str, where: object) -> None:
    if known is not None:
        raise InputError("the same is said twice", where=where, expected=EXAMPLE, got=clause)


def _unread(text: str, expected: str, where: object) -> InputError:
    return InputError("cannot read the start", where=where, expected=expected, got=repr(text))
