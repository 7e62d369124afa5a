"""Read p2o's own JSON, a result of `--export json:FILE` or `--out`, or a run with several; export complete results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from p2o import Exporter, InputError, Method, Options, Result, Status
from p2o.reading import Calibration, Reading, Source, provenance, result_from_dict, result_to_json, write_whole

from p2o_formats.format import EXAMPLE, Format


def recognises(source: Source) -> bool:
    """Return whether the file contains a result or a run with results."""
    results = source.tree.get("results")
    return _is_result(source.tree) or (isinstance(results, list) and any(map(_is_result, results)))


def _is_result(value: Any) -> bool:
    return isinstance(value, Mapping) and {"frames", "status", "camera_from_lidar"} <= value.keys()


def read(source: Source, reading: Reading) -> Calibration:
    """Return the pose of a result and its camera.

    Raises InputError for results without an estimated pose, and unless the name of the reading, that of a frame or a
    camera, selects exactly one result.
    """
    entries = [source.tree] if _is_result(source.tree) else [v for v in source.tree["results"] if _is_result(v)]
    wanted = [e for e in entries if not reading.name or reading.name in (e.get("camera"), *_names(e))]
    if len(wanted) != 1:
        fault, expected = f"{len(wanted) or 'none'} of {len(entries)} results match", "FILE#NAME of a frame or a camera"
        raise InputError(fault, where=source.path, expected=expected, got=reading.name or None)
    result = result_from_dict(wanted[0])
    if not result.status.solved:
        fault, got = "the result has no estimated pose", f"{result.status.value} ({result.reason})"
        raise InputError(fault, where=source.path, expected="a solved calibration", got=got)
    remarks = () if result.verdict.trusted else (f"{source.path}: the result is {result.verdict.trust}",)
    return Calibration(result.intrinsics, result.camera_from_lidar, remarks=remarks, comment=provenance(result))


def _names(entry: Mapping[str, Any]) -> list[Any]:
    frames = entry.get("frames")
    return frames if isinstance(frames, list) else []


def example() -> bytes:
    """Return a result with the calibration of `EXAMPLE`."""
    pose = EXAMPLE.extrinsic()
    result = Result(("frame",), pose, pose, Status.CONVERGED, "", intrinsics=EXAMPLE.intrinsics())
    return result_to_json(result).encode()


def build(options: Options) -> Exporter:
    """Return the exporter."""

    def export(result: Result, path: Path) -> None:
        write_whole(path, result_to_json(result).encode())

    return export


EXPORTER = Method(
    name="json",
    build=build,
    gives={"verdict"},
    summary="The complete result, with rounds, recipe and versions; p2o.results.result_json reads it.",
)

FORMAT = Format(
    name="json",
    summary="A result of p2o.",
    rank=20,
    direction="camera_from_lidar",
    suffix=".json",
    fields=frozenset({"name"}),
    recognises=recognises,
    read=read,
    example=example,
)
