"""The page of one run, result.html: every result with verdict, pose, overlays and advice, in one file.

It is made from the folder of `p2o run --out`, run.json and the overlays in it, and can be made again from there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from p2o.arrays import Float, UInt8
from p2o.calibration_files.number_text import digits, listed, matrix_rows, plain, quaternion_xyzw, spaced
from p2o.draw.image_uri import jpeg_uri
from p2o.errors import InputError
from p2o.files.file_names import distinct_names
from p2o.files.input_file import MAX_TEXT_BYTES, read_bytes, read_start, read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_errors, write_whole
from p2o.geometry import se3
from p2o.geometry.pose_error import AXES
from p2o.geometry.pose_text import numbers
from p2o.geometry.rpy import rpy_of
from p2o.page import page
from p2o.page.convergence import convergence
from p2o.page.plot import plot
from p2o.results.advice import next_steps
from p2o.results.figures import result_lines, result_name, status_text
from p2o.results.result import Result
from p2o.results.result_json import result_from_dict
from p2o.results.verdict import Trust

RUN, RESULT, PAGE = "run.json", "result.json", "result.html"
IN_ROOT = (RUN, RESULT, PAGE)
"""Files in the folder of a run itself: no folder of a frame can have one of these names."""
OVERLAYS = (
    ("{}.png", "edges of both sensors"),
    ("sweep-range-{}.png", "the sweep, by range"),
    ("sweep-reflectance-{}.png", "the sweep, by reflectance"),
)
"""Files of a frame's folder, with "before" or "after" in the name, and what they show."""
COMMON = "common.png"
"""The file with the edges of both sensors at the common result of a rig."""
_MOST_FRAMES, _MOST_CHARS = 24, 2_500_000
"""At most this number of frames is shown; overlays beyond this number of characters are files beside the page."""
_PNG = b"\x89PNG\r\n\x1a\n"
_MOST_PIXELS = 100_000_000
_WIDEST_PX = 65_535
"""Longest side of a JPEG."""
_DECIMALS = 9
"""Decimals of poses on the page, in metres or as elements of rotations; result.json contains all digits."""
_ROS_KEYS = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class Pair:
    """Two overlays `left` and `right` as data URIs or paths, what they show, and of which poses (`ends`)."""

    what: str
    left: str
    right: str
    ends: tuple[str, str] = ("before", "after")


@dataclass(frozen=True)
class FrameOverlays:
    """The overlays of one frame and their size in px; `pairs` are superimposed."""

    name: str
    width: int
    height: int
    pairs: Sequence[Pair]


@dataclass(frozen=True)
class Shown:
    """One result in the JSON of a run, with its errors where the ground truth is known."""

    result: Result
    camera: str
    error: Mapping[str, Any] | None
    start_error: Mapping[str, Any] | None
    overlays: list[FrameOverlays] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The title of the result."""
        return result_name(self.result, self.camera)


def run_page(
    root: Path, run: Mapping[str, Any], folders: Mapping[str, str] | None = None, home: Path | None = None
) -> str:
    """Return the page of a run, `run` being the object of its run.json; overlays are read from `root`.

    `folders` are the names of the folders by frame (default: those that names of frames give), `home` is the folder of
    the page (default: `root`). At most 24 frames are shown, the least trusted results first. Overlays have the full
    size of the image; those that would make the page larger than 3 MB are loaded from their files, on demand. Raises
    InputError for what is no object of `p2o run`.
    """
    shown, failed = _read(run)
    if folders is None:
        cameras = [one.camera for one in shown if one.camera] if "rig" in run else []
        frames = [frame for one in shown for frame in one.result.frames]
        names = list(dict.fromkeys([*cameras, *frames, *(frame for frame, _ in failed)]))
        folders = distinct_names(names, taken=IN_ROOT)
    rig = _map(run["rig"]) if "rig" in run else None
    common = rig is not None and numbers(rig.get("body_from_lidar"), (4, 4)) is not None
    files = _Files(root, root if home is None else home)
    _add_overlays(files, shown, folders, common=common)
    blocks = [*([] if rig is None else [_rig(rig)]), *([_overview(shown)] if len(shown) > 1 else [])]
    if failed:
        blocks.append(page.text(f"{len(failed)} could not be calibrated:", "bad"))
        blocks.append(page.items([f"{frame}: {reason}" for frame, reason in failed]))
    blocks += [_result(number, one, folders) for number, one in enumerate(shown)]
    versions = shown[0].result.versions if shown else {}
    blocks.append(
        page.section(
            "",
            page.text(
                "67 % of results with these predicted errors are within the first bound, 95 % within the second. One "
                "click selects a box of numbers. Dark images are brightened for display only; the gamma is stated in "
                "the image.",
                "quiet",
            ),
            page.text(", ".join(f"{name} {version}" for name, version in versions.items()), "quiet"),
            ruled=True,
        )
    )
    title = shown[0].name if len(shown) == 1 else f"{len(shown)} calibrations"
    return page.page(f"{title}: p2o result", blocks, image_files=files.referenced)


def _overview(shown: Sequence[Shown]) -> page.Block:
    """Return the table of all results, with links to them."""
    bounds = [
        ("rotation", "deg", 2),
        ("translation", "m", 3),
        ("rotation 95 %", "deg", 2),
        ("translation 95 %", "m", 3),
    ]
    fields = ("rotation_deg", "translation_m", "rotation_deg_95", "translation_m_95")
    looks = page.TRUST_LOOKS
    columns = [
        page.Column("result", text=True, of=lambda one: one.name),
        page.Column(
            "verdict", text=True, hide=0, order=list(Trust), looks=looks, of=lambda one: one.result.verdict.trust.value
        ),
        page.Column("status", text=True, hide=3, of=lambda one: status_text(one.result.status)),
        *(
            page.Column(*bound, hide=2, of=partial(_accuracy, name=name))
            for bound, name in zip(bounds, fields, strict=True)
        ),
    ]
    links = [page.link(f"result-{number}") for number in range(len(shown))]
    note = page.text("Predicted errors (67 %, 95 %).", "quiet")
    return page.section("Results", page.table(columns, shown, name="results", search=len(shown) > 9, opens=links), note)


def _accuracy(one: Shown, name: str) -> float | None:
    return page.brief(getattr(one.result.accuracy, name, None))


def _result(number: int, one: Shown, folders: Mapping[str, str]) -> page.Block:
    """Return the section of one result."""
    result, verdict = one.result, one.result.verdict
    reasons = [reason.text for reason in verdict.reasons if reason.text != result.reason]
    reasons = reasons or (["no doubts"] if verdict.trusted else [])
    blocks = [page.text(f"{status_text(result.status)}: {result.reason}", mark=verdict.trust.value)]
    blocks += [page.items(reasons)] if reasons else []
    next_to_do = page.part("What to do next", page.items(next_steps(result)))
    blocks.append(page.grid(page.part("", _predicted(one), next_to_do), page.part("", *_poses(result))))
    for frame in one.overlays:
        size = (frame.width, frame.height)
        edges, *others = [
            page.slides(f"{frame.name}: {p.what}", p.left, p.right, p.ends, size, lazy=not p.left.startswith("data:"))
            for p in frame.pairs
        ]
        tall = frame.height > frame.width
        blocks.append({"kind": "light"})
        blocks += [page.grid(edges, *others, least=300)] if tall else [edges, page.grid(*others, least=540)]
    not_drawn = len(result.frames) - len(one.overlays)
    if not_drawn:
        known = [folders[frame] for frame in result.frames[:3] if frame in folders]
        places = ", ".join(known) + (" ..." if not_drawn > 3 else "")
        what = "further frames" if one.overlays else "frames"
        blocks.append(page.text(f"Overlays of {not_drawn} {what} are in the folder of this page: {places}", "quiet"))
    # The seconds have a table of their own.
    evidence = [line for line in result_lines(result) if line[0] != "seconds"]
    seconds = [(stage, f"{took:.2f} s") for stage, took in result.seconds.items()]
    times = [page.part("Time", page.facts(seconds))] if seconds else []
    rounds = [page.part("Rounds", page.table(ROUND_COLUMNS, result.rounds))] if result.rounds else []
    blocks.append(page.grid(page.part("Evidence", page.facts(evidence)), page.part("", *rounds, *times)))
    blocks += [plot(convergence(result).panels)] if result.rounds else []
    content = {"recipe": dict(result.recipe), "seed": result.seed, "versions": dict(result.versions)}
    recipe = json.dumps(content, indent=1, ensure_ascii=False, default=str)
    blocks.append(page.fold("recipe, seed, versions", page.code(recipe)))
    return page.section(one.name, *blocks, name=f"result-{number}", ruled=True)


def _predicted(one: Shown) -> page.Block:
    """Return predicted errors, overall and by axis, with the true errors where they are known."""
    accuracy, error = one.result.accuracy, one.error
    if accuracy is None and error is None:
        return page.part("Predicted error", page.text("The error cannot be predicted: do not rely on this result."))
    rows = []
    for name in ("rotation_deg", "translation_m", *AXES):
        axis, _, unit = name.rpartition("_")
        values = (getattr(accuracy, name, None), getattr(accuracy, f"{name}_95", None))
        row = [f"{axis} [{unit}]", *(page.number_text(value, 2 if unit == "deg" else 3) for value in values)]
        if error is not None:
            row += [page.number_text(_map(each).get(name), 3) for each in (one.start_error, error)]
        rows.append(row)
    names = ("67 %", "95 %", *(("initial error", "error") if error is not None else ()))
    columns = [page.Column("axis", text=True), *map(page.Column, names)]
    note = page.text("Camera axes: x right, y down, z forward.", "quiet")
    return page.part("Predicted error", page.table(columns, rows), note)


def _poses(result: Result) -> Iterator[page.Block]:
    """Yield the pose in common forms to copy, by direction; a refused result has its initial guess."""
    if not result.status.solved:
        yield page.text("There is no new pose: this is the initial guess.", "bad")
    camera_from_lidar = result.camera_from_lidar
    lidar_from_camera = se3.inverse(camera_from_lidar)
    for name, pose in (("camera_from_lidar", camera_from_lidar), ("lidar_from_camera", lidar_from_camera)):
        vector = spaced(np.round([*pose[:3, 3], *quaternion_xyzw(pose)], _DECIMALS))
        angles = spaced(np.round(np.degrees(rpy_of(pose[:3, :3])), _DECIMALS))
        yield page.code(_matrix(pose), f"{name}, 4x4", paste=True)
        yield page.code(vector, f"{name}, x y z [m], quaternion x y z w", paste=True)
        yield page.code(angles, f"{name}, roll pitch yaw [deg]: R = Rz(yaw) Ry(pitch) Rx(roll)", paste=True)
    yield page.text("Rounded to 9 decimals; result.json has all digits.", "quiet")
    axes = "Axes of camera_optical_frame: x right, y down, z forward."
    yield page.text(f"Static transform lidar_from_camera of ROS 2. {axes}", "quiet")
    values = plain(np.round([*lidar_from_camera[:3, 3], *quaternion_xyzw(lidar_from_camera)], _DECIMALS))
    words = " ".join(f"--{key} {digits(value)}" for key, value in zip(_ROS_KEYS, values, strict=True))
    command = f"ros2 run tf2_ros static_transform_publisher {words}"
    yield page.code(f"{command} --frame-id lidar --child-frame-id camera_optical_frame", "ROS 2", paste=True)


ROUND_COLUMNS = (
    page.Column("stage", text=True, of=lambda one: one.stage),
    page.Column("reach", "px", hide=3, of=lambda one: page.cell(page.brief(one.reach_px), f"{one.reach_px:.3g}")),
    page.Column("matches", of=lambda one: sum(one.matches.values())),
    page.Column("residual", "px", 3, of=lambda one: page.brief(one.mean_residual)),
    page.Column("cost", digits=3, hide=2, of=lambda one: page.brief(one.cost)),
    page.Column("step", "deg", 3, hide=2, of=lambda one: page.brief(one.step_deg)),
    page.Column("step", "m", 3, hide=3, of=lambda one: page.brief(one.step_m)),
    page.Column("kept", text=True, of=lambda one: "yes" if one.accepted else "no"),
)
"""The columns of rounds."""


def page_of_folder(root: Path, home: Path | None = None) -> str:
    """Return the page of a folder of `p2o run --out` for the folder `home`; raises InputError for any other folder."""
    path = root / RUN
    run = parse_json(read_text(path, "run"), "run", path)
    if not isinstance(run, Mapping):
        raise InputError("this is no object of p2o run", where=path, expected="results, failed, summary")
    try:
        return run_page(root, run, home=home)
    except InputError as problem:
        raise InputError(f"the run cannot be shown: {problem.what}", where=path, got=problem.got) from problem


def write_page_of_folder(root: Path, out: Path | None = None) -> Path:
    """Write the page of a folder of `p2o run --out` into it, or into the folder `out`, and return its path.

    Raises InputError as `page_of_folder`, and where it cannot be written.
    """
    home = root if out is None else out
    html = page_of_folder(root, home)
    with write_errors("the page", home):
        home.mkdir(parents=True, exist_ok=True)
    write_whole(home / PAGE, html.encode())
    return home / PAGE


def _read(run: Mapping[str, Any]) -> tuple[list[Shown], list[tuple[str, str]]]:
    rows, failed = run.get("results"), run.get("failed", [])
    if not isinstance(rows, list) or not isinstance(failed, list) or not isinstance(run.get("rig", {}), Mapping):
        raise InputError("this is no object of p2o run", expected="results, failed, summary")
    shown = []
    for row in rows:
        result = result_from_dict(row)
        error, start_error = (_error(row.get(name)) for name in ("error", "start_error"))
        shown.append(Shown(result, str(row.get("camera", "")), error, start_error))
    reasons = [(str(one.get("frame")), str(one.get("reason"))) for one in failed if isinstance(one, Mapping)]
    return shown, reasons


def _error(value: Any) -> Mapping[str, Any] | None:
    """Return the errors by name, per_axis among them, or None where there are none."""
    if not isinstance(value, Mapping):
        return None
    by_axis = value.get("per_axis")
    return {**value, **(by_axis if isinstance(by_axis, Mapping) else {})}


@dataclass(eq=False)
class _Files:
    """Overlays in the folder `root` as sources of images on a page in `home`: embedded up to a limit, then paths."""

    root: Path
    home: Path
    embedded: int = 0
    referenced: bool = False

    def pair(self, pair: Pair) -> Pair:
        """Return a pair of files as a pair of sources."""
        paths = [self.root / name for name in (pair.left, pair.right)]
        uris: list[str] = []
        if self.embedded < _MOST_CHARS:
            uris = [jpeg_uri(_image(path), _WIDEST_PX) for path in paths]
        size = sum(map(len, uris))
        if not uris or self.embedded + size > _MOST_CHARS:
            self.referenced = True
            folder = Path(os.path.relpath(self.root, self.home))
            uris = [quote((folder / name).as_posix()) for name in (pair.left, pair.right)]
            size = 0
        self.embedded += size
        return replace(pair, left=uris[0], right=uris[1])


def _add_overlays(files: _Files, shown: Sequence[Shown], folders: Mapping[str, str], *, common: bool) -> None:
    """Add the overlays of results: one frame of each result in turn, the least trusted result first.

    With `common`, frames also have the overlay of the common result of the rig. The edges of all frames are embedded
    before the sweeps.
    """
    order = sorted(shown, key=lambda one: -list(Trust).index(one.result.verdict.trust))
    depth = max((len(one.result.frames) for one in shown), default=0)
    turns = [(one, one.result.frames[turn]) for turn in range(depth) for one in order if turn < len(one.result.frames)]
    for one, frame in turns:
        if sum(len(each.overlays) for each in shown) == _MOST_FRAMES:
            break
        one.overlays.extend(_overlays(files.root, folders[frame], frame, common=common) if frame in folders else ())
    drawn = [(one, number) for number in range(depth) for one in order if number < len(one.overlays)]
    for what in dict.fromkeys(what for _, what in OVERLAYS):
        for one, number in drawn:
            overlays = one.overlays[number]
            pairs = [files.pair(pair) if pair.what == what else pair for pair in overlays.pairs]
            one.overlays[number] = replace(overlays, pairs=pairs)


def _overlays(root: Path, folder: str, frame: str, *, common: bool) -> Iterator[FrameOverlays]:
    """Yield the overlays in the folder of a frame, if there are any before and after, as paths from `root`."""
    asked = [
        (what, [name.format(time) for time in ("before", "after")], ("before", "after")) for name, what in OVERLAYS
    ]
    asked[1:1] = [(OVERLAYS[0][1], ["after.png", COMMON], ("own result", "common result"))] if common else []
    pairs: list[Pair] = []
    sizes: list[tuple[int, int]] = []
    for what, names, ends in asked:
        paths = [f"{folder}/{name}" for name in names if (root / folder / name).is_file()]
        size = {_size(root / path) for path in paths}
        if len(paths) == 2 and len(size) == 1:
            pairs.append(Pair(what, paths[0], paths[1], ends))
            sizes += size
    if pairs:
        width, height = sizes[0]
        yield FrameOverlays(frame, width, height, pairs)


def _size(path: Path) -> tuple[int, int]:
    """Return width and height of a PNG file in px."""
    head = read_start(path, "overlay", 24)
    width, height = (int.from_bytes(head[at : at + 4], "big") for at in (16, 20))
    # A small PNG file may declare a huge image in its header.
    if not (head.startswith(_PNG) and 0 < width * height <= _MOST_PIXELS):
        raise _no_png(path)
    return width, height


def _image(path: Path) -> UInt8:
    import cv2

    pixels = cv2.imdecode(np.frombuffer(read_bytes(path, "overlay", MAX_TEXT_BYTES), np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise _no_png(path)
    return np.ascontiguousarray(pixels[..., ::-1])


def _no_png(path: Path) -> InputError:
    return InputError("the overlay is not a PNG image", where=path, expected="a file that p2o run has written")


def _rig(rig: Mapping[str, Any]) -> page.Block:
    """Return the common result of a rig; values of other types count as unknown."""
    accuracy, body = _map(rig.get("accuracy")), numbers(rig.get("body_from_lidar"), (4, 4))
    blocks = [page.text(str(rig.get("reason", "")), mark=str(_map(rig.get("verdict")).get("trust")))]
    if accuracy:
        angle, length = (page.number_text(accuracy.get(n), d) for n, d in (("rotation_deg", 2), ("translation_m", 3)))
        blocks.append(page.text(f"Predicted error (67 %): {angle} deg and {length} m."))
    blocks += [] if body is None else [page.code(_matrix(body), "body_from_lidar, 4x4", paste=True)]
    rows = []
    for its in map(_map, rig.get("cameras") or ()):
        figures = (("rotation_deg", 2), ("translation_m", 3), ("chi_square", 1))
        values = [page.number_text(its.get(name), places) for name, places in figures]
        rows.append([str(its.get("name")), *values, str(its.get("left_out", ""))])
    named = page.Column("camera", text=True)
    columns = [named, page.Column("from the others", "deg"), page.Column("from the others", "m")]
    columns += [page.Column("chi-square (6)"), page.Column("left out", text=True)]
    return page.section("Rig", *blocks, page.table(columns, rows, name="rig"))


def _matrix(pose: Float) -> str:
    return "[" + ",\n ".join(listed(row) for row in matrix_rows(np.round(pose, _DECIMALS))) + "]"


def _map(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
