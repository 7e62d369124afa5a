"""Parse an initial guess in words: directions of the LiDAR's axes, viewing direction and position of the camera."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.perturb import FARTHEST_M

# The frame of the words is that of the vehicle: x forward, y left, z up.
_DIRECTIONS = {"forward": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0)}
_DIRECTIONS |= {"right": (0.0, -1.0, 0.0), "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0)}
_HEADINGS_DEG = {"forward": 0.0, "left": 90.0, "back": 180.0, "right": -90.0}
_TILTS_DEG = {"up": 90.0, "down": -90.0}
_UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}

EXAMPLE = '"roughly x forward, z up; camera looks forward"'
_AXES_FORM = "two axes of x, y, z, each with one of " + ", ".join(_DIRECTIONS) + ': "x forward, z up"'
_LOOK_FORM = (
    'forward, back, left, right or "45 deg left" or right; then, if need be, "10 deg down" or up, and "upside down" or '
    '"turned 90 deg clockwise" or counterclockwise: "camera looks 45 deg left, 10 deg down"'
)
_PLACE_FORM = 'lengths, each with a direction: "camera 0.3 m forward, 1.2 m down of lidar"'
_NUMBER = r"(\d{1,6}(?:\.\d{1,9})?|\.\d{1,9})"


def is_rough_start(text: str) -> bool:
    """Return whether a text describes an initial guess in words: its first word is "roughly"."""
    return text.lower().split(maxsplit=1)[:1] == ["roughly"]


def rough_start(text: str, where: object = "start") -> Float:
    """Return camera_from_lidar (4, 4) of a text such as "roughly x forward, z up; camera looks forward".

    The text has up to three clauses, separated by ";", in any order: the directions of two of the LiDAR's axes (the
    third follows from a right-handed frame); "camera looks" with heading, tilt and roll; and "camera 0.3 m forward,
    1.2 m down of lidar", by default the same position. Forward, left and up are those of the vehicle. The heading is
    relative to forward, the tilt to the horizon. "clockwise" is the roll of the camera seen from behind: at 90 deg, its
    right side is below. "upside down" is a roll of 180 deg.

    Raises InputError with the clause that cannot be read and an example.
    """
    if not is_rough_start(text):
        raise _unreadable(text, EXAMPLE, where)
    rest = text.strip().lower().partition(" ")[2]
    known: dict[Callable[[str, object], Float], Float] = {}
    for clause in (part.strip() for part in rest.split(";")):
        of_camera = _camera_from_car if clause.startswith("camera looks") else _camera_place
        read = of_camera if clause.startswith("camera") else _car_from_lidar
        if read in known:
            raise InputError("a clause is repeated", where=where, expected=EXAMPLE, got=clause)
        known[read] = read(clause, where)
    axes, look, place = (known.get(read) for read in (_car_from_lidar, _camera_from_car, _camera_place))
    if axes is None:
        raise InputError("the directions of the LiDAR's axes are missing", where=where, expected=_AXES_FORM, got=text)
    if look is None:
        raise InputError("the viewing direction of the camera is missing", where=where, expected=_LOOK_FORM, got=text)
    return se3.make(look @ axes, np.zeros(3) if place is None else -look @ place)


def _car_from_lidar(clause: str, where: object) -> Float:
    """Return the rotation (3, 3) whose columns are the directions of the LiDAR's axes."""
    columns: dict[int, Float] = {}
    for piece in _pieces(clause.removeprefix("lidar ")):
        axis, _, direction = piece.partition(" ")
        if axis not in ("x", "y", "z") or direction not in _DIRECTIONS or "xyz".index(axis) in columns:
            raise _unreadable(clause, _AXES_FORM, where)
        columns["xyz".index(axis)] = np.array(_DIRECTIONS[direction])
    if len(columns) not in (2, 3):
        raise _unreadable(clause, _AXES_FORM, where)
    for third in {0, 1, 2} - columns.keys():
        columns[third] = np.cross(columns[(third + 1) % 3], columns[(third + 2) % 3])
    matrix = np.stack([columns[number] for number in range(3)], axis=1)
    if not np.isclose(np.linalg.det(matrix), 1):
        expected = "directions at right angles; with x forward and y left z is up"
        raise InputError("the LiDAR's axes are not a right-handed frame", where=where, expected=expected, got=clause)
    return matrix


def _camera_from_car(clause: str, where: object) -> Float:
    """Return the rotation (3, 3) camera_from_car; the axes of the car are forward, left and up."""
    angles_deg: dict[str, float] = {}
    for piece in _pieces(clause.removeprefix("camera looks")):
        name, angle_deg = _camera_turn(piece, clause, where)
        if name in angles_deg:
            raise _unreadable(clause, _LOOK_FORM, where)
        angles_deg[name] = angle_deg
    cos, sin = {}, {}
    for name in ("heading", "tilt", "roll"):
        angle = np.radians(angles_deg.get(name, 0.0))
        # Rounded, so that multiples of 90 deg are exact.
        cos[name], sin[name] = np.round(np.cos(angle), 15), np.round(np.sin(angle), 15)
    ahead = np.array([cos["heading"], sin["heading"], 0.0])
    look = cos["tilt"] * ahead + np.array([0.0, 0.0, sin["tilt"]])
    right = np.array([sin["heading"], -cos["heading"], 0.0])
    down = np.cross(look, right)
    turned_right, turned_down = cos["roll"] * right + sin["roll"] * down, cos["roll"] * down - sin["roll"] * right
    return np.stack([turned_right, turned_down, look]) + 0.0


def _camera_turn(piece: str, clause: str, where: object) -> tuple[str, float]:
    """Return the name of an angle (heading, tilt or roll) and its value in degrees."""
    if piece in _HEADINGS_DEG:
        return "heading", _HEADINGS_DEG[piece]
    if piece in _TILTS_DEG:
        return "tilt", _TILTS_DEG[piece]
    if piece == "upside down":
        return "roll", 180.0
    match = re.fullmatch(rf"(turned )?{_NUMBER} ?deg (left|right|up|down|clockwise|counterclockwise)", piece)
    if match is None:
        raise _unreadable(clause, _LOOK_FORM, where)
    turned, angle_deg, direction = match[1] is not None, float(match[2]), match[3]
    name = {"left": "heading", "right": "heading", "up": "tilt", "down": "tilt"}.get(direction, "roll")
    if turned != (name == "roll") or angle_deg > (90 if name == "tilt" else 180):
        raise _unreadable(clause, _LOOK_FORM, where)
    return name, -angle_deg if direction in ("right", "down", "counterclockwise") else angle_deg


def _camera_place(clause: str, where: object) -> Float:
    """Return the position (3,) of the camera relative to the LiDAR, in metres along forward, left and up."""
    match = re.fullmatch(r"camera (.+) of (?:the )?lidar", clause)
    if match is None:
        raise _unreadable(clause, _PLACE_FORM, where)
    place = np.zeros(3)
    for piece in _pieces(match[1]):
        match_of_piece = re.fullmatch(rf"{_NUMBER} ?(m|cm|mm) ({'|'.join(_DIRECTIONS)})", piece)
        step = None if match_of_piece is None else np.array(_DIRECTIONS[match_of_piece[3]])
        if match_of_piece is None or step is None or (place * step).any():
            raise _unreadable(clause, _PLACE_FORM, where)
        length_m = float(match_of_piece[1]) * _UNITS_M[match_of_piece[2]]
        if length_m > FARTHEST_M:
            raise InputError("the camera is too far away", where=where, expected=f"at most {FARTHEST_M:g} m", got=piece)
        place += length_m * step
    return place


def _pieces(text: str) -> Sequence[str]:
    return [" ".join(piece.split()) for piece in text.split(",")]


def _unreadable(text: str, expected: str, where: object) -> InputError:
    return InputError("cannot read the initial guess", where=where, expected=expected, got=repr(text))
