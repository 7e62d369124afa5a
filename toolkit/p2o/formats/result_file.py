"""The JSON of p2o itself: a result of `--export json:FILE` or `--out`, or a run with several; read only here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from p2o.errors import InputError
from p2o.files.input_file import naming
from p2o.formats.calibration import Calibration
from p2o.formats.format import BOTH, Format, Reading
from p2o.formats.source import Source
from p2o.results.result_json import result_from_dict


def recognises(source: Source) -> bool:
    """Return whether it is a result, or holds some."""
    results = source.tree.get("results")
    return _is_result(source.tree) or (isinstance(results, list) and any(map(_is_result, results)))


def _is_result(value: Any) -> bool:
    return isinstance(value, Mapping) and {"frames", "status", "camera_from_lidar"} <= value.keys()


def read(source: Source, reading: Reading) -> Calibration:
    """Return the pose of a result and the camera that it is for.

    Raises InputError for results without a new pose, and where it is not said which of several is meant: by the name
    of a frame or a camera.
    """
    entries = [source.tree] if _is_result(source.tree) else [v for v in source.tree["results"] if _is_result(v)]
    wanted = [e for e in entries if not reading.name or reading.name in (e.get("camera"), *_names(e))]
    if len(wanted) != 1:
        raise InputError(
            f"{len(wanted) or 'none'} of {len(entries)} results can be the one",
            where=source.path,
            expected="FILE#NAME of a frame or a camera",
            got=reading.name or None,
        )
    with naming(source.path):
        result = result_from_dict(wanted[0])
    if not result.status.solved:
        raise InputError(
            "this result has no new pose",
            where=source.path,
            expected="a solved calibration",
            got=f"{result.status.value} ({result.reason})",
        )
    remarks = () if result.verdict.trusted else (f"{source.path}: the result is {result.verdict.trust}",)
    return Calibration(result.intrinsics, result.camera_from_lidar, remarks=remarks)


def _names(entry: Mapping[str, Any]) -> list[Any]:
    frames = entry.get("frames")
    return frames if isinstance(frames, list) else []


FORMAT = Format(
    name="json",
    summary="A result of p2o.",
    holds=BOTH,
    direction="camera_from_lidar",
    suffix=".json",
    recognises=recognises,
    read=read,
)
