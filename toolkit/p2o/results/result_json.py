"""A result as JSON and back, without loss: floats keep every bit, arrays are lists, the status is its word.

JSON has no word for what is not finite: NaN is null, infinities are the texts "inf" and "-inf".
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from p2o.arrays import Float, checked
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.results.accuracy import Accuracy
from p2o.results.result import CameraCheck, Result, Round, Status, SweepMotion

Reader = Callable[[str, Any], Any]


def result_to_dict(result: Result) -> dict[str, Any]:
    """Return a result as dicts, lists, numbers, texts and None, in the order of its fields; JSON takes it as it is.

    Raises InputError if the recipe holds something that JSON has no form for.
    """
    return {f.name: _plain(f.name, getattr(result, f.name)) for f in fields(Result)}


def result_from_dict(value: Any) -> Result:
    """Return the result of what `result_to_dict` gave; every number is the same to the last bit.

    An object of `p2o run` is taken too; its errors against the truth, which are no part of a Result, are left out.
    Tuples within the recipe come back as lists. Raises InputError for a missing or unknown field, a value of another
    kind, or a pose that is not rigid; the text names the field.
    """
    if isinstance(value, Mapping):
        value = {key: part for key, part in value.items() if key not in ("error", "start_error")}
    return Result(**_fields("the result", value, _RESULT))


def result_to_json(result: Result) -> str:
    """Return a result as JSON text of one line a field or round, ending in a newline."""
    return json.dumps(result_to_dict(result), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def result_from_json(text: str) -> Result:
    """Return the result of JSON text; raises InputError as `result_from_dict`, and for text that is not JSON."""
    try:
        value = json.loads(text)
    except ValueError as problem:
        raise InputError("the result is not JSON", expected="what the exporter json wrote", got=problem) from problem
    return result_from_dict(value)


def _plain(name: str, value: Any) -> Any:
    if isinstance(value, Accuracy | Round | CameraCheck | Camera | SweepMotion):
        return {f.name: _plain(f"{name}.{f.name}", getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(f"{name}.{key}", entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(name, entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, str):
        return str(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    raise InputError(f"{name} has no form in JSON", expected="numbers, texts, lists, dicts", got=type(value).__name__)


def _fields(name: str, value: Any, readers: Mapping[str, Reader]) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise _wrong(name, "an object", value)
    missing, unknown = [k for k in readers if k not in value], [k for k in value if k not in readers]
    if missing or unknown:
        said = [f"{', '.join(keys)} {word}" for keys, word in ((missing, "missing"), (unknown, "unknown")) if keys]
        raise InputError(f"{name} has other fields", expected=", ".join(readers), got="; ".join(said))
    return {key: read(key, value[key]) for key, read in readers.items()}


def _wrong(name: str, expected: str, got: Any) -> InputError:
    return InputError(f"{name} is not {expected}", got=repr(got)[:60])


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise _wrong(name, "a text", value)
    return value


def _boolean(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise _wrong(name, "true or false", value)
    return value


def _integer(name: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise _wrong(name, "a whole number", value)
    return value


def _number(name: str, value: Any) -> float:
    if value is None:
        return math.nan
    if value in ("inf", "-inf"):
        return float(value)
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise _wrong(name, "a number", value)
    return float(value)


def _optional(read: Reader) -> Reader:
    return lambda name, value: None if value is None else read(name, value)


def _tuple(read: Reader, length: int | None = None) -> Reader:
    def many(name: str, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, Sequence) or isinstance(value, str) or length not in (None, len(value)):
            raise _wrong(name, "a list" if length is None else f"a list of {length}", value)
        return tuple(read(name, entry) for entry in value)

    return many


def _mapping(read: Reader) -> Reader:
    def named(name: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise _wrong(name, "an object", value)
        return {key: read(f"{name}.{key}", entry) for key, entry in value.items()}

    return named


def _matrix(side: int) -> Reader:
    rows = _tuple(_tuple(_number, side), side)

    def matrix(name: str, value: Any) -> Float:
        array: Float = checked(name, rows(name, value), (side, side), np.float64, finite=False)
        return array

    return matrix


def _pose(name: str, value: Any) -> Float:
    matrix: Float = _matrix(4)(name, value)
    se3.check_rigid(name, matrix)  # which returns a cleaned rotation; the bits of the file are kept instead
    return matrix


def _status(name: str, value: Any) -> Status:
    words = [status.value for status in Status]
    if value not in words:
        raise InputError(f"{name} is unknown", expected=" or ".join(words), got=repr(value)[:60])
    return Status(value)


def _as_is(_name: str, value: Any) -> Any:
    return value


_ROUND: dict[str, Reader] = {
    "stage": _text,
    "reach_px": _number,
    "matches": _mapping(_integer),
    "mean_residual_px": _number,
    "directed_cost_px": _number,
    "step_deg": _number,
    "step_m": _number,
    "accepted": _boolean,
}


def _round(name: str, value: Any) -> Round:
    return Round(**_fields(f"an entry of {name}", value, _ROUND))


_CAMERA: dict[str, Reader] = {"model": _text, "width": _integer, "height": _integer, "params": _tuple(_number)}


def _camera(name: str, value: Any) -> Camera:
    return Camera(**_fields(name, value, _CAMERA))


_CAMERA_CHECK: dict[str, Reader] = {
    "frames": _integer,
    "camera": _camera,
    "better": _camera,
    "focal": _number,
    "focal_sigma": _number,
    "radial": _number,
    "radial_sigma": _number,
    "shift_px": _number,
    "shift_sigma_px": _number,
    "corrected": _boolean,
}


def _camera_check(name: str, value: Any) -> CameraCheck:
    return CameraCheck(**_fields(f"an entry of {name}", value, _CAMERA_CHECK))


_ACCURACY: dict[str, Reader] = {
    "rotation_deg": _number,
    "translation_m": _number,
    "rotation_deg_95": _number,
    "translation_m_95": _number,
}


def _accuracy(name: str, value: Any) -> Accuracy:
    return Accuracy(**_fields(name, value, _ACCURACY))


_MOTION: dict[str, Reader] = {
    "frame": _text,
    "speed_m_s": _number,
    "speed_sigma": _number,
    "turn_deg_s": _number,
    "turn_sigma": _number,
    "twist": _tuple(_number, 6),
}


def _motion(name: str, value: Any) -> SweepMotion:
    return SweepMotion(**_fields(f"an entry of {name}", value, _MOTION))


_RESULT: dict[str, Reader] = {
    "frames": _tuple(_text),
    "start": _pose,
    "camera_from_lidar": _pose,
    "status": _status,
    "reason": _text,
    "rounds": _tuple(_round),
    "covariance": _optional(_matrix(6)),
    "accuracy": _optional(_accuracy),
    "matches": _mapping(_integer),
    "residual_px": _mapping(_number),
    "directed_cost_px": _optional(_tuple(_number, 2)),
    "agreement": _mapping(_number),
    "rival": _mapping(_number),
    "cameras": _tuple(_camera_check),
    "motions": _tuple(_motion),
    "seconds": _mapping(_number),
    "warnings": _tuple(_text),
    "recipe": _mapping(_as_is),
    "seed": _optional(_integer),
    "versions": _mapping(_text),
}
