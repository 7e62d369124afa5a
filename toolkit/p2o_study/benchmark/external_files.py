"""Files of calibration programs outside p2o: their inputs from the frames of a suite, and poses from their results.

A form is a TOML file, PACKAGE/external/NAME.toml of a plugin: what a program reads for one calibration, in which
direction and order, and how its result is read. Poses of p2o are camera_from_lidar in metres.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from string import Template
from typing import Annotated, Any, Literal

import numpy as np
from p2o.arrays import Float, UInt8
from p2o.calibration_files.number_text import digits, listed, matrix_rows, quaternion_xyzw, spaced
from p2o.draw.coloured_cloud import ply_bytes
from p2o.errors import InputError, one_line
from p2o.files.input_file import listing, read_text
from p2o.files.parsed_text import parse_json, parse_toml
from p2o.files.whole_file import write_errors, write_whole
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.pose_text import read_pose
from p2o.host.registry import Registry
from p2o.options import Options, validated
from pydantic import AfterValidator, Field, StringConstraints

from p2o_study.benchmark.score import KEY, MATRIX, Key, Start, csv_text, pose_cells, pose_in, records, starts_csv
from p2o_study.study import named_file, shipped_toml
from p2o_study.worker import frames_of

FOLDER = "external"
"""Folder of forms in a package: PACKAGE/external/NAME.toml."""
STARTS = "starts.csv"
"""The file of initial guesses in a folder of inputs; line N belongs to the folder of number N - 2."""
_SEPARATORS = re.compile(r"[\s,;()\[\]]+")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_NEAR_DEG = 60.0
"""A pose that is farther from its initial guess than this, while its inverse is not, was written as its inverse."""
_LENS = ("fx", "fy", "cx", "cy")
_POSE = ("rows", "numbers", "line", "translation", "xyzw", "wxyz", "xyz_xyzw")
WORDS = {"folder", "count", "names", "width", "height", *_LENS, *_POSE}
"""Words that $WORD in texts of a form is replaced by (docs/how-to/published-network.md)."""


def _inner(path: str) -> str:
    parts = PurePosixPath(path).parts
    if not parts or path.startswith("/") or ".." in parts or re.search(r"[\\:\x00]", path):
        raise ValueError("a path inside the folder of a calibration, such as img/%06d.png")
    return path


def _numbered(*suffixes: str) -> AfterValidator:
    """Return the check of a path with the number of the frame and one of the suffixes."""

    def numbered(path: str) -> str:
        if not re.fullmatch(r"[^%]*%(0[1-9])?d[^%]*", path) or not path.endswith(suffixes):
            raise ValueError(
                f"a path with the number of the frame, such as img/%06d{suffixes[0]} ({', '.join(suffixes)})"
            )
        return path

    return AfterValidator(numbered)


def _known_words(text: str) -> str:
    if not Template(text).is_valid() or set(Template(text).get_identifiers()) - WORDS:
        raise ValueError(f"a text with ${', $'.join(sorted(WORDS))}; $$ is a dollar")
    return text


Inner = Annotated[str, StringConstraints(min_length=1, max_length=200), AfterValidator(_inner)]
Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=4000)]
Direction = Literal["camera_from_lidar", "lidar_from_camera"]


class TextFile(Options):
    """A text that the program reads; `text` has the words of `WORDS` as $WORD."""

    path: Inner
    text: Annotated[str, StringConstraints(max_length=20_000), AfterValidator(_known_words)]


class ResultFile(Options):
    """What the program writes: numbers in JSON below `keys`, or in a text after the first of the lines `after`.

    `order` is "matrix" for 3 or 4 rows of 4 numbers, else that of a translation in metres and a unit quaternion.
    """

    path: Inner
    keys: tuple[int | str, ...] = ()
    after: tuple[Text, ...] = ()
    order: Literal["matrix", "xyz xyzw", "xyz wxyz"] = "matrix"
    direction: Direction = "camera_from_lidar"


class Form(Options):
    """The files of one program for one calibration; `source` names the repository and files that document them.

    `image` and `cloud` are paths with the number of the frame, whose suffix is the file format. `direction` is that of
    the pose in `file`. `intensity` "ranked" is the rank among the points in 256 steps of [0, 1). Points nearer than
    `near_m` are left out. `joint` programs calibrate several frames at once. `run` is the command for one folder.
    """

    title: Text
    source: Text
    run: Text
    remark: Text
    image: Annotated[Inner, _numbered(".png", ".bmp")]
    cloud: Annotated[Inner, _numbered(".pcd", ".ply", ".bin")]
    result: ResultFile
    file: tuple[TextFile, ...] = ()
    direction: Direction = "camera_from_lidar"
    joint: bool = False
    grey_equalised: bool = False
    intensity: Literal["measured", "ranked"] = "measured"
    near_m: Annotated[float, Field(ge=0, le=100)] = 0.0


def find_form(word: str, registry: Registry) -> Form:
    """Return the form of a name, or of the path of a TOML file.

    Raises UnknownNameError for an unknown name or key, InputError for a file that cannot be read or is not valid.
    """
    path = named_file(word, shipped_toml(registry, FOLDER), "form of an external program")
    return validated(Form, parse_toml(read_text(path, "form"), "form", path), where=path)


def write_inputs(folder: Path, starts: Mapping[Key, Start], form: Form) -> int:
    """Write the inputs of a program, one folder for each calibration, and starts.csv; return the number of folders.

    Names of files are numbers: nothing of the data decides where they are. Images are those of a pinhole camera
    (`Image.undistorted`), sweeps without ground truth as the data set has them.

    Raises InputError for a folder that is not empty, for a joint calibration if the program has none, and for frames of
    different cameras.
    """
    with write_errors("the inputs", folder):
        folder.mkdir(parents=True, exist_ok=True)
    if listing(folder, "inputs"):
        raise InputError("the folder is not empty", where=folder, expected="a new folder: old results may be in it")
    joint = [key for key, start in starts.items() if start.case.joint]
    if joint and not form.joint:
        hint, got = "choose single frames with --section", f"{len(joint)} joint calibrations"
        raise InputError(f"{form.title} calibrates single frames", where=joint[0][0], got=got, hint=hint)
    write_whole(folder / STARTS, starts_csv(starts).encode())
    for number, start in enumerate(starts.values()):
        assert start.case.start is not None
        for path, data in files_of(frames_of(start.records), start.case.start, form, _folder(folder, number)):
            with write_errors("the inputs", folder):
                path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, data)
    return len(starts)


def files_of(frames: Sequence[Frame], start: Float, form: Form, folder: Path) -> Iterator[tuple[Path, bytes]]:
    """Yield path and bytes of each input of one calibration from camera_from_lidar `start` (4, 4)."""
    cameras: set[Camera] = set()
    for number, frame in enumerate(frames):
        image = frame.image.undistorted()
        cameras.add(image.camera)
        if len(cameras) > 1:
            raise InputError("the frames are of different cameras", where=frame.name, expected="equal intrinsics")
        image_path, cloud_path = folder / (form.image % number), folder / (form.cloud % number)
        yield image_path, _encoded(image.rgb, image_path.suffix, form.grey_equalised)
        yield cloud_path, _CLOUDS[cloud_path.suffix](_points(frame.cloud, form))
    words = _words(folder, form, len(frames), cameras.pop(), start)
    for file in form.file:
        yield folder / file.path, Template(file.text).substitute(words).encode()


def _folder(folder: Path, number: int) -> Path:
    return folder / f"{number:04d}"


def _encoded(rgb: UInt8, suffix: str, grey_equalised: bool) -> bytes:
    import cv2

    pixels: Any = cv2.equalizeHist(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)) if grey_equalised else rgb[..., ::-1]
    return bytes(cv2.imencode(suffix, pixels)[1])


def _points(cloud: Cloud, form: Form) -> Any:
    """Return x, y, z (metres) and intensity (N, 4) as little-endian float32; the intensity is 0 if there is none."""
    cloud = cloud.select(np.linalg.norm(cloud.xyz, axis=1) >= form.near_m)
    intensity = np.zeros(len(cloud)) if cloud.intensity is None else cloud.intensity
    if form.intensity == "ranked":
        rank = np.argsort(np.argsort(intensity, kind="stable"), kind="stable")
        intensity = np.floor(256 * rank / len(rank)) / 256
    return np.column_stack([cloud.xyz, intensity]).astype("<f4")


def _pcd(points: Any) -> bytes:
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n"
        f"COUNT 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    return head.encode() + bytes(points.tobytes())


_CLOUDS: Mapping[str, Callable[[Any], bytes]] = {
    ".pcd": _pcd,
    ".ply": lambda points: ply_bytes(dict(zip(("x", "y", "z", "intensity"), points.T, strict=True))),
    ".bin": lambda points: bytes(points.tobytes()),
}


def _words(folder: Path, form: Form, count: int, camera: Camera, start: Float) -> dict[str, str]:
    """Return the words of `WORDS` in JSON, which YAML accepts; the folder is without quotation marks."""
    pose = se3.inverse(start) if form.direction == "lidar_from_camera" else start
    xyzw = quaternion_xyzw(pose)
    return {
        "folder": json.dumps(folder.resolve().as_posix())[1:-1],
        "count": str(count),
        "names": json.dumps([Path(form.image % number).stem for number in range(count)]),
        "width": str(camera.width),
        "height": str(camera.height),
        **dict(zip(_LENS, map(digits, camera.params), strict=True)),
        "rows": f"[{', '.join(map(listed, matrix_rows(pose)))}]",
        "numbers": listed(pose),
        "line": spaced(pose[:3]),
        "translation": listed(pose[:3, 3]),
        "xyzw": listed(xyzw),
        "wxyz": listed([xyzw[3], *xyzw[:3]]),
        "xyz_xyzw": listed([*pose[:3, 3], *xyzw]),
    }


def poses_csv(folder: Path, form: Form) -> str:
    """Return the results in a folder of `write_inputs` as the file of poses that `score` reads.

    An empty file of a result is a refused calibration. Raises InputError for a missing result, one in another format,
    and if most poses are near their initial guess only when inverted.
    """
    rows, inverted, count = [], 0, 0
    for number, (line, values) in enumerate(records(folder / STARTS)):
        pose, start = read_result(_folder(folder, number), form.result), pose_in(values, f"{folder / STARTS}:{line}")
        rows.append([*(values[name] for name in KEY), *pose_cells(pose)])
        if pose is not None and start is not None:
            count += 1
            inverted += _angle_deg(start, se3.inverse(pose)) < _NEAR_DEG < _angle_deg(start, pose)
    if inverted > count / 2:
        fault, expected = "most poses are near their initial guess only when inverted", form.result.direction
        raise InputError(fault, where=folder, expected=expected, got=f"{inverted} of {count}")
    return csv_text((*KEY, *MATRIX), rows)


def _angle_deg(start: Float, pose: Float) -> float:
    return se3.angle_deg(se3.inverse(start) @ pose)


def read_result(folder: Path, result: ResultFile) -> Float | None:
    """Return camera_from_lidar (4, 4) of the result in the folder of one calibration, None for an empty file.

    Raises InputError for a file that is missing, leads out of the folder, or has another format.
    """
    path = folder / result.path
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError("the result is a link out of its folder", where=path, expected=f"a file in {folder}")
    if path.is_file() and not path.stat().st_size:
        return None
    text = read_text(path, "result")
    values = _below(parse_json(text, "result", path), result, path) if result.keys else _after(text, result, path)
    name = ".".join(map(str, result.keys)) or "the pose"
    if result.order != "matrix":
        if not isinstance(values, list) or len(values) != 7:
            raise _no_pose(name, result, values, path)
        quaternion = values[3:] if result.order == "xyz xyzw" else [*values[4:], values[3]]
        values = {"translation_m": values[:3], "rotation_xyzw": quaternion}
    pose, _ = read_pose(name, values, path)
    return se3.inverse(pose) if result.direction == "lidar_from_camera" else pose


def _below(value: Any, result: ResultFile, path: Path) -> Any:
    for key in result.keys:
        known = isinstance(value, dict) if isinstance(key, str) else isinstance(value, list) and len(value) == key + 1
        if not known or (isinstance(key, str) and key not in value):
            raise _no_pose(".".join(map(str, result.keys)), result, value, path)
        value = value[key]
    return value


def _after(text: str, result: ResultFile, path: Path) -> list[float]:
    """Return the numbers after the first of the lines `after` that the text has, up to the first other word."""
    if result.after:
        head = next((head for head in result.after if head in text), None)
        if head is None:
            raise InputError("the result has no pose", where=path, expected=result.after[0], got=one_line(text[:60]))
        text = text.split(head, 1)[1]
    words = [word for word in _SEPARATORS.split(text) if word not in ("", "tensor")]
    end = next((number for number, word in enumerate(words) if not _NUMBER.fullmatch(word)), len(words))
    if end < len(words) and not result.after:
        raise _no_pose("the pose", result, words[end], path)
    return [float(word) for word in words[:end]]


def _no_pose(name: str, result: ResultFile, got: Any, path: Path) -> InputError:
    expected = "3 or 4 rows of 4 numbers" if result.order == "matrix" else f"7 numbers: {result.order}"
    return InputError(f"{name} is not a pose", where=path, expected=expected, got=one_line(str(got)[:60]))
