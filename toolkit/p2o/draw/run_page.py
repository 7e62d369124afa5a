"""The page of one run, result.html: every result with verdict, pose, overlays and advice, in one file.

It is made from the folder of `p2o run --out`, run.json and the overlays in it, and can be made again from there.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Float, UInt8
from p2o.calibration_files.number_text import digits, listed, matrix_rows, plain, quaternion_xyzw, spaced
from p2o.draw.one_file import filled, jpeg_uri, part
from p2o.errors import InputError, printable
from p2o.files.file_names import distinct_names
from p2o.files.input_file import read_bytes, read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.geometry import se3
from p2o.geometry.pose_error import AXES
from p2o.geometry.rpy import rpy_of
from p2o.results.advice import next_steps
from p2o.results.figures import result_lines
from p2o.results.result import Result
from p2o.results.result_json import result_from_dict
from p2o.results.verdict import Trust

RUN, RESULT, ROUNDS, PAGE = "run.json", "result.json", "convergence.png", "result.html"
IN_ROOT = (RUN, RESULT, ROUNDS, PAGE)
"""Files in the folder of a run itself: no folder of a frame can have one of these names."""
OVERLAYS = (
    ("{}.png", "edges of both sensors"),
    ("sweep-range-{}.png", "the sweep, by range"),
    ("sweep-reflectance-{}.png", "the sweep, by reflectance"),
)
"""Files of a frame's folder, with "before" or "after" in the name, and what they show."""
_MOST_FRAMES, _MOST_CHARS = 8, 24_000_000
"""At most this number of frames is shown, and none once the overlays exceed this number of characters."""
_MOST_PIXELS = 100_000_000
_ROS_KEYS = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class Shown:
    """One result in the JSON of a run, with its errors where the ground truth is known."""

    result: Result
    camera: str
    error: Mapping[str, Any] | None
    start_error: Mapping[str, Any] | None

    @property
    def name(self) -> str:
        """The title of the result."""
        frames = self.result.frames
        name = frames[0] if len(frames) == 1 else f"{len(frames)} frames jointly"
        return name if self.camera in name else f"{name} ({self.camera})"


def run_page(root: Path, run: Mapping[str, Any], folders: Mapping[str, str] | None = None) -> str:
    """Return the page of a run, `run` being the object of its run.json; overlays are read from `root`.

    `folders` are the names of the folders by frame (default: those that names of frames give). At most
    8 frames are shown, the least trusted results first. Raises InputError for what is no object of `p2o run`.
    """
    shown, failed = _read(run)
    if folders is None:
        cameras = [one.camera for one in shown if one.camera] if "rig" in run else []
        frames = [frame for one in shown for frame in one.result.frames]
        names = list(dict.fromkeys([*cameras, *frames, *(frame for frame, _ in failed)]))
        folders = distinct_names(names, taken=IN_ROOT)
    figures = _figures(root, shown, folders)
    results = [_article(number, one, figures[number], folders) for number, one in enumerate(shown)]
    title = shown[0].name if len(shown) == 1 else f"{len(shown)} calibrations"
    versions = shown[0].result.versions if shown else {}
    script = part("run_page.js")
    parts = {
        "title": _text(f"{title}: p2o result"),
        "style": part("run_page.css"),
        "summary": _summary(shown, failed, run.get("rig")),
        "results": "\n".join(results),
        "versions": _text(", ".join(f"{name} {version}" for name, version in versions.items())),
        "script": script,
    }
    return filled(part("run_page.html"), parts, scripts=(script,))


def page_of_folder(root: Path) -> str:
    """Return the page of a folder of `p2o run --out`; raises InputError for any other folder."""
    path = root / RUN
    run = parse_json(read_text(path, "run"), "run", path)
    if not isinstance(run, Mapping):
        raise InputError("this is no object of p2o run", where=path, expected="results, failed, summary")
    try:
        return run_page(root, run)
    except InputError as problem:
        raise InputError(f"the run cannot be shown: {problem.what}", where=path, got=problem.got) from problem


def write_page_of_folder(root: Path, out: Path | None = None) -> Path:
    """Write the page of a folder of `p2o run --out` into it, or into the folder `out`, and return its path.

    Raises InputError as `page_of_folder`, and where it cannot be written.
    """
    page = page_of_folder(root)
    home = root if out is None else out
    try:
        home.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError("cannot write the page", where=home, got=problem.strerror or str(problem)) from problem
    write_whole(home / PAGE, page.encode())
    return home / PAGE


def _read(run: Mapping[str, Any]) -> tuple[list[Shown], list[tuple[str, str]]]:
    rows, failed = run.get("results"), run.get("failed", [])
    if not isinstance(rows, list) or not isinstance(failed, list) or not isinstance(run.get("rig", {}), Mapping):
        raise InputError("this is no object of p2o run", expected="results, failed, summary")
    shown = []
    for row in rows:
        result = result_from_dict(row)
        errors = (_error(row.get(name)) for name in ("error", "start_error"))
        shown.append(Shown(result, str(row.get("camera", "")), *errors))
    reasons = [(str(one.get("frame")), str(one.get("reason"))) for one in failed if isinstance(one, Mapping)]
    return shown, reasons


def _error(value: Any) -> Mapping[str, Any] | None:
    """Return the errors by name, per_axis among them, or None where there are none."""
    if not isinstance(value, Mapping):
        return None
    by_axis = value.get("per_axis")
    return {**value, **(by_axis if isinstance(by_axis, Mapping) else {})}


# ---- overlays


def _figures(root: Path, shown: Sequence[Shown], folders: Mapping[str, str]) -> list[list[str]]:
    """Return the overlays of each result: one frame of each result in turn, the least trusted result first."""
    order = sorted(range(len(shown)), key=lambda i: -list(Trust).index(shown[i].result.verdict.trust))
    depth = max((len(one.result.frames) for one in shown), default=0)
    turns = [(i, turn) for turn in range(depth) for i in order if turn < len(shown[i].result.frames)]
    figures: list[list[str]] = [[] for _ in shown]
    drawn, size = 0, 0
    for i, turn in turns:
        if drawn == _MOST_FRAMES or size > _MOST_CHARS:
            break
        frame = shown[i].result.frames[turn]
        overlays = list(_sliders(root / folders[frame], frame)) if frame in folders else []
        if overlays:
            figures[i].append("\n".join(overlays))
            drawn, size = drawn + 1, size + sum(map(len, overlays))
    return figures


def _sliders(folder: Path, frame: str) -> Iterator[str]:
    """Yield one block of overlays, before and after, of those in the folder of a frame."""
    pairs = []
    for name, what in OVERLAYS:
        paths = [folder / name.format(time) for time in ("before", "after")]
        images = [_image(path) for path in paths if path.is_file()]
        if len(images) == 2 and images[0].shape == images[1].shape:
            pairs.append((what, images))
    if not pairs:
        return
    height, width = pairs[0][1][0].shape[:2]
    yield f'<div class="overlays{" tall" if height > width else ""}">'
    for what, images in pairs:
        before, after = map(jpeg_uri, images)
        label = _text(f"{frame}: {what}")
        yield (
            f'<figure class="slides"><div class="compare"><img src="{after}" alt="{label}, at the result" '
            f'width="{width}" height="{height}" draggable="false"><img src="{before}" '
            f'alt="{label}, at the initial guess" draggable="false"><div class="edge"></div></div>'
            '<div class="ends"><span>before</span>'
            '<input class="slider" type="range" min="0" max="100" step="0.5" value="50" aria-label="before to after">'
            f"<span>after</span></div><figcaption>{label}</figcaption></figure>"
        )
    yield "</div>"


def _image(path: Path) -> UInt8:
    import cv2

    data = np.frombuffer(read_bytes(path, "overlay"), np.uint8)
    # A small PNG file may declare a huge image in its header.
    width, height = (int.from_bytes(data[at : at + 4].tobytes(), "big") for at in (16, 20))
    pixels = cv2.imdecode(data, cv2.IMREAD_COLOR) if 0 < width * height <= _MOST_PIXELS else None
    if pixels is None:
        raise InputError("the overlay is not a PNG image", where=path, expected="a file that p2o run has written")
    return np.ascontiguousarray(pixels[..., ::-1])


# ---- words


def _summary(shown: Sequence[Shown], failed: Sequence[tuple[str, str]], rig: Any) -> str:
    parts = []
    if isinstance(rig, Mapping):
        parts.append(_rig(rig))
    if len(shown) > 1:
        head = ("result", "verdict", "status", "rotation [deg]", "translation [m]", "95 %")
        rows = []
        for number, one in enumerate(shown):
            its, trust = one.result.accuracy, one.result.verdict.trust
            likely = ("-", "-", "-")
            if its is not None:
                rare = f"{its.rotation_deg_95:.2f} deg, {its.translation_m_95:.3f} m"
                likely = (f"{its.rotation_deg:.2f}", f"{its.translation_m:.3f}", rare)
            link = f'<a href="#result-{number}">{_text(one.name)}</a>'
            word = f'<span class="{trust.value}">{trust.value}</span>'
            rows.append([link, word, _text(one.result.status.value), *likely])
        parts.append(_table(head, rows, texts=3))
        parts.append('<p class="quiet">Predicted errors (67 %, 95 %).</p>')
    if failed:
        items = "".join(f"<li>{_text(frame)}: {_text(reason)}</li>" for frame, reason in failed)
        parts.append(f'<p class="refused">{len(failed)} could not be calibrated:</p><ul>{items}</ul>')
    return "\n".join(parts)


def _rig(rig: Mapping[str, Any]) -> str:
    """Return the common result of a rig and its table of cameras."""
    verdict, accuracy = (_map(rig.get(name)) for name in ("verdict", "accuracy"))
    trust = str(verdict.get("trust"))
    parts = [f"<h2>Rig</h2><p>{_badge(trust)} {_text(rig.get('reason', ''))}</p>"]
    if accuracy:
        usual = f"{_number(accuracy.get('rotation_deg'), 2)} deg and {_number(accuracy.get('translation_m'), 3)} m"
        parts.append(f"<p>Predicted error (67 %): {usual}.</p>")
    body = _pose(rig.get("body_from_lidar"))
    if body is not None:
        parts.append("<h3>body_from_lidar, 4x4</h3>" + _paste(_matrix(body)))
    rows = []
    for camera in rig.get("cameras") or ():
        its = _map(camera)
        apart = (_number(its.get("rotation_deg"), 2), _number(its.get("translation_m"), 3))
        rows.append([_text(its.get("name")), *apart, _number(its.get("chi_square"), 1), _text(its.get("left_out", ""))])
    head = ("camera", "from the others [deg]", "[m]", "chi-square (6)", "left out")
    parts.append('<div id="rig">' + _table(head, rows, texts=1) + "</div>")
    return "\n".join(parts)


def _article(number: int, shown: Shown, figures: Sequence[str], folders: Mapping[str, str]) -> str:
    result = shown.result
    verdict = result.verdict
    texts = [reason.text for reason in verdict.reasons if reason.text != result.reason]
    reasons = "".join(f"<li>{_text(text)}</li>" for text in texts) or ("<li>no doubts</li>" if verdict.trusted else "")
    parts = [
        f'<article id="result-{number}"><h2>{_text(shown.name)}</h2>',
        f"<p>{_badge(verdict.trust.value)} {_text(result.status.value)}: {_text(result.reason)}</p>",
        f'<ul class="reasons">{reasons}</ul>' if reasons else "",
        '<div class="facts"><div><h3>Predicted error</h3>' + _predicted(shown),
        '<div class="next"><h3>What to do next</h3><ul>'
        + "".join(f"<li>{_text(step)}</li>" for step in next_steps(result))
        + "</ul></div></div>",
        '<div class="pose">' + _pose_forms(result) + "</div></div>",
        *figures,
    ]
    left = len(result.frames) - len(figures)
    if left:
        where = ", ".join(folders[f] for f in result.frames[:3] if f in folders) + (" ..." if left > 3 else "")
        more = "further frames" if figures else "frames"
        parts.append(f'<p class="quiet">Overlays of {left} {more} are in the folder of this page: {_text(where)}</p>')
    rounds = [
        (
            _text(r.stage),
            f"{r.reach_px:.3g}",
            str(sum(r.matches.values())),
            *(_number(value, 3) for value in (r.mean_residual, r.cost, r.step_deg, r.step_m)),
            "yes" if r.accepted else "no",
        )
        for r in result.rounds
    ]
    head = ("stage", "reach [px]", "matches", "residual [px]", "cost", "step [deg]", "step [m]", "kept")
    provenance = {"recipe": dict(result.recipe), "seed": result.seed, "versions": dict(result.versions)}
    seconds = [(_text(stage), f"{took:.2f} s") for stage, took in result.seconds.items()]
    # The seconds have a table of their own.
    evidence = [(_text(line[0]), _text(line[1])) for line in result_lines(result) if line[0] != "seconds"]
    parts += [
        '<div class="facts"><div><h3>Evidence</h3>' + _table((), evidence, texts=2) + "</div>",
        "<div><h3>Rounds</h3>" + _table(head, rounds, texts=1) if rounds else "<div>",
        "<h3>Time</h3>" + _table((), seconds, texts=1) if seconds else "",
        "</div></div>",
        "<details><summary>recipe, seed, versions</summary><pre>"
        + _text(json.dumps(provenance, indent=1, ensure_ascii=False, default=str), lines=True)
        + "</pre></details></article>",
    ]
    return "\n".join(piece for piece in parts if piece)


def _predicted(shown: Shown) -> str:
    """Return the table of predicted errors, overall and by axis, with the true errors where they are known."""
    accuracy, error = shown.result.accuracy, shown.error
    if accuracy is None and error is None:
        return "<p>The error cannot be predicted: do not rely on this result.</p>"
    rows = []
    for name in ("rotation_deg", "translation_m", *AXES):
        axis, _, unit = name.rpartition("_")
        values = (getattr(accuracy, name, None), getattr(accuracy, f"{name}_95", None))
        row = [f"{axis} [{unit}]", *(_number(value, 2 if unit == "deg" else 3) for value in values)]
        if error is not None:
            row += [_number(_map(e).get(name), 3) for e in (shown.start_error, error)]
        rows.append(row)
    head = ["", "67 %", "95 %", *(["initial error", "error"] if error is not None else [])]
    return _table(head, rows, texts=1) + '<p class="quiet">Camera axes: x right, y down, z forward.</p>'


def _pose_forms(result: Result) -> str:
    """Return the pose in common forms to copy; a refused result shows its initial guess."""
    pose = result.camera_from_lidar
    refused = '<p class="refused">There is no new pose: this is the initial guess.</p>'
    parts = ["" if result.status.solved else refused]
    for name, transform in (("camera_from_lidar", pose), ("lidar_from_camera", se3.inverse(pose))):
        numbers = f"{spaced(transform[:3, 3])} {spaced(quaternion_xyzw(transform))}"
        rpy = " ".join(digits(round(value, 9)) for value in plain(np.degrees(rpy_of(transform[:3, :3]))))
        parts.append(f'<div class="{name}"><h3>{name}, 4x4</h3>{_paste(_matrix(transform))}')
        parts.append(f"<h3>{name}, x y z [m], quaternion x y z w</h3>{_paste(numbers)}")
        parts.append(f"<h3>{name}, roll pitch yaw [deg]: R = Rz(yaw) Ry(pitch) Rx(roll)</h3>{_paste(rpy)}</div>")
    about = "Static transform lidar_from_camera of ROS 2. Axes of camera_optical_frame: x right, y down, z forward."
    parts.append(f'<h3>ROS 2</h3><p class="quiet">{about}</p><div class="ros">{_paste(_ros_command(pose))}</div>')
    return "".join(parts)


def _ros_command(camera_from_lidar: Float) -> str:
    """Return the shell command that publishes lidar_from_camera: metres, quaternion x y z w."""
    lidar_from_camera = se3.inverse(camera_from_lidar)
    values = [*plain(lidar_from_camera[:3, 3]), *quaternion_xyzw(lidar_from_camera)]
    words = [f"--{key} {digits(value)}" for key, value in zip(_ROS_KEYS, values, strict=True)]
    frames = "--frame-id lidar --child-frame-id camera_optical_frame"
    return f"ros2 run tf2_ros static_transform_publisher {' '.join(words)} {frames}"


def _matrix(pose: Float) -> str:
    return "[" + ",\n ".join(listed(row) for row in matrix_rows(pose)) + "]"


def _pose(value: Any) -> Float | None:
    """Return a transform (4, 4) of JSON, None for anything else."""
    if value is None:
        return None
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return matrix if matrix.shape == (4, 4) and np.isfinite(matrix).all() else None


# ---- HTML


def _text(value: Any, *, lines: bool = False) -> str:
    """Return a text escaped for HTML and its attributes; control characters are written out."""
    texts = str(value).split("\n") if lines else [str(value)]
    return "\n".join(escape(printable(text, 5000)) for text in texts)


def _badge(trust: str) -> str:
    known = trust if trust in list(Trust) else "refused"
    return f'<span class="verdict {known}">{_text(trust)}</span>'


def _paste(text: str) -> str:
    return f'<pre class="paste" title="one click selects all" tabindex="0">{_text(text, lines=True)}</pre>'


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], texts: int) -> str:
    """Return a table whose cells are HTML already; the first `texts` columns are texts."""
    kinds = [' class="text"' if column < texts else "" for column in range(max(map(len, [head, *rows])))]
    top = "".join(f"<th{kind}>{_text(name)}</th>" for kind, name in zip(kinds, head, strict=False))
    body = "".join(
        "<tr>" + "".join(f"<td{kind}>{cell}</td>" for kind, cell in zip(kinds, row, strict=False)) + "</tr>"
        for row in rows
    )
    head_row = f"<thead><tr>{top}</tr></thead>" if top else ""
    return f'<div class="scroll"><table>{head_row}<tbody>{body}</tbody></table></div>'


def _map(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _number(value: Any, places: int) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "-"
    return f"{value:.{places}f}"
