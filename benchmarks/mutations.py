"""The share of deliberate faults that `make test` catches, in this source tree or an older one.

    python benchmarks/mutations.py --out build/mutations.json
    python benchmarks/mutations.py --tree OLD --python OLD-VENV/bin/python --out build/mutations-old.json

Each fault of `MUTATIONS` replaces one text in a copy of the tree: a flipped sign, swapped axes, a dropped guard, leaked
ground truth, in all rooms and packages. Stage 1 runs the nearest tests: files named after the module, files that import
it, and if these are few, files of the same room. Stage 2 runs all other tests of `make test`, if stage 1 passes. Tests
that also fail without the fault do not count. `--tree` may be of the layout before the packages p2o_study, p2o_sim and
others (commit 5993b9f): faults name the path in both.

Exit status: 0 if all faults were tried, 2 if a text to replace is not there exactly once, with one line for each. The
interpreter needs the packages of requirements.lock and the tree's distribution, whose entry points name the plugins.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

_SOURCES = ("toolkit", "plugins", "baselines")
_MOST_IMPORTERS, _FEW = 8, 3
"""Most test files of stage 1 beside those named after the module; below `_FEW` in all, files of its room fill up."""
_SLOW = frozenset(
    {
        "ablate", "all_pages", "basin", "conformance", "distribution", "docs_site", "example_plugin", "example_workflow",
        "fuzz", "gate", "in_browser", "kills", "notebook", "pages", "pick_page", "plugin_command",
        "real_accuracy", "real_motion", "report_page", "rivals", "ros_bag_page", "run_page", "simulate_command",
        "staged_families", "synthetic", "table1", "train_command", "trouble", "tutorials", "view_page",
        "whole_families",
    }
)  # fmt: skip
"""Test files that take minutes, or are no part of `make test`: in stage 1 only if named after the module."""
_LIMITS_S = (1800.0, 4 * 3600.0)
"""Time limits of the two stages: a fault that makes the tests hang is caught."""
_FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/\S+?\.py(?:::.+?)?)(?: - .*)?$", re.MULTILINE)


@dataclass(frozen=True)
class Mutation:
    """A fault: `find` becomes `replace` in the file `path`.

    `old_path`, `old_find` and `old_replace` are those of the layout before, empty where they are the same.
    """

    name: str
    room: str
    kind: str
    path: str
    find: str
    replace: str
    old_path: str = ""
    old_find: str = ""
    old_replace: str = ""

    def place(self, tree: Path) -> tuple[str, str, str]:
        """Return path, text and replacement in a tree of either layout."""
        if is_new(tree):
            return self.path, self.find, self.replace
        return self.old_path or self.path, self.old_find or self.find, self.old_replace or self.replace

    def misfit(self, tree: Path) -> str:
        """Return why the fault cannot be injected into a tree, "" if it can."""
        path, find, replace = self.place(tree)
        if not (tree / path).is_file():
            return f"{self.name}: {path}: no such file"
        count = (tree / path).read_text(encoding="utf-8").count(find)
        if count != 1:
            return f"{self.name}: {path}: the text is there {count} times instead of once: {find}"
        return "" if find != replace else f"{self.name}: the replacement is the same text"


_T, _P, _B = "toolkit/p2o", "plugins/p2o_plugins", "baselines/p2o_baselines"
MUTATIONS = (
    Mutation(
        "exp-sign", "geometry", "flipped sign", f"{_T}/geometry/se3.py", "b * xy - a * z", "b * xy + a * z"
    ),
    Mutation(
        "resize-half-pixel", "geometry", "off by one", f"{_T}/geometry/camera.py",
        "params[index] = before * grown - 0.5", "params[index] = before * grown",
    ),
    Mutation(
        "error-axes", "geometry", "swapped axes", f"{_T}/geometry/pose_error.py",
        "pitch, yaw, roll = np.degrees(", "yaw, pitch, roll = np.degrees(",
    ),
    Mutation(
        "centimetres", "geometry", "wrong unit", f"{_T}/geometry/perturb.py",
        '"m": 1, "cm": 0.01', '"m": 1, "cm": 0.1',
    ),
    Mutation(
        "upper-is-lower", "features", "flipped sign", f"{_T}/features/side.py",
        "(0, -1), (0, 1))[self + 1]", "(0, 1), (0, -1))[self + 1]",
    ),
    Mutation(
        "left-edge-column", "features", "off by one", f"{_T}/features/occlusion.py",
        "maps[Side.LEFT, :, 1:] =", "maps[Side.LEFT, :, :-1] =",
    ),
    Mutation(
        "truth-in-frame", "frames", "leaked truth", f"{_T}/frames/frame.py",
        "return replace(self, camera_from_lidar=None)", "return replace(self)",
    ),
    Mutation(
        "range-end", "frames", "off by one", f"{_T}/frames/selection.py",
        "return range(first, last + 1)", "return range(first, last)",
    ),
    Mutation(
        "image-height", "frames", "dropped guard", f"{_T}/frames/image_file.py",
        "if size is not None and have != size:", "if size is not None and have[0] != size[0]:",
        f"{_P}/data/image_file.py",
    ),
    Mutation(
        "zip-bomb", "files", "dropped guard", f"{_T}/files/array_file.py",
        "if size > most or len(entries) > _MAX_ENTRIES:", "if len(entries) > _MAX_ENTRIES:",
    ),
    Mutation(
        "part-file-left", "files", "dropped guard", f"{_T}/files/whole_file.py",
        "part.unlink(missing_ok=True)", "pass",
    ),
    Mutation(
        "hint-lost", "errors", "lost error message", f"{_T}/errors.py",
        '("got ", got), ("", hint)):', '("got ", got)):',
    ),
    Mutation(
        "depth-derivative", "problems", "flipped sign", f"{_T}/problems/point_to_line.py",
        "np.negative(columns[5], out=columns[5])", "np.positive(columns[5], out=columns[5])",
    ),
    Mutation(
        "gradient-weight", "problems", "ignored weight", f"{_T}/problems/normal_equations.py",
        "slope *= problem.weight", "slope *= 1.0",
    ),
    Mutation(
        "sigma-in-metres", "problems", "wrong unit", f"{_T}/problems/directed_cost.py",
        "(view.camera.focal_px * edges.sigma_m / distance)", "(view.camera.focal_px * edges.sigma_m)",
    ),
    Mutation(
        "worse-is-better", "calibration", "inverted comparison", f"{_T}/calibration/rounds.py",
        "better = cost < cost_of_best", "better = cost > cost_of_best",
    ),
    Mutation(
        "time-offset", "calibration", "flipped sign", f"{_T}/calibration/nuisance.py",
        "pose_at(twist, -offset_s)", "pose_at(twist, offset_s)",
    ),
    Mutation(
        "degrees-of-freedom", "confidence", "off by one", f"{_T}/confidence/fusion.py",
        "degrees = 6 * (len(opinions) - 1)", "degrees = 6 * len(opinions)", f"{_T}/calibration/fusion.py",
    ),
    Mutation(
        "level-edges", "confidence", "swapped axes", f"{_T}/confidence/accuracy.py",
        "np.abs(problem.normal[:, 1]) > np.abs(problem.normal[:, 0])",
        "np.abs(problem.normal[:, 0]) > np.abs(problem.normal[:, 1])",
        f"{_T}/calibration/shifts.py",
    ),
    Mutation(
        "weak-agreement", "confidence", "dropped guard", f"{_T}/confidence/verdict.py",
        "agreed.odds_ratio >= options.min_odds_ratio and agreed.strength >= options.min_strength",
        "agreed.odds_ratio >= options.min_odds_ratio",
        f"{_T}/calibration/verdict.py",
    ),
    Mutation(
        "truth-to-accumulator", "run", "leaked truth", f"{_T}/run/joined.py",
        "self._accumulate([f.without_truth() for f in frames], len(before))",
        "self._accumulate(frames, len(before))",
    ),
    Mutation(
        "misfit-passes", "run", "dropped guard", f"{_T}/run/fit.py",
        "if not given and not open_yet:", "if not given and not open_yet and giver.kind == Kind.DATASET:",
    ),
    Mutation(
        "failed-frames", "run", "dropped guard", f"{_T}/run/run.py",
        "return bool(self.rows) and not self.failed and common and", "return bool(self.rows) and common and",
    ),
    Mutation(
        "truth-to-calibrator", "host", "leaked truth", f"{_T}/host/guard.py",
        "value = prepare(frame.without_truth())", "value = prepare(replace(frame))",
        old_find="frame = frame.without_truth()", old_replace="frame = replace(frame)",
    ),
    Mutation(
        "blocked-plugin", "host", "dropped guard", f"{_T}/host/registry.py",
        "if allowed and not any(source.answers_to(word) for word in unwanted):", "if allowed:",
    ),
    Mutation(
        "best-trust", "results", "inverted comparison", f"{_T}/results/verdict.py",
        "return max((reason.doubt.trust for reason in self.reasons)",
        "return min((reason.doubt.trust for reason in self.reasons)",
        "",
        "return max((word for word in words if word is not None)",
        "return min((word for word in words if word is not None)",
    ),
    Mutation(
        "either-error", "results", "dropped guard", f"{_T}/results/evidence.py",
        "self.rotation_deg <= rotation_deg and self.translation_m",
        "self.rotation_deg <= rotation_deg or self.translation_m",
        f"{_T}/results/accuracy.py",
    ),
    Mutation(
        "array-shape", "cache", "wrong key", f"{_T}/cache.py",
        "{value.dtype.str} {value.shape};", "{value.dtype.str};", f"{_T}/work/cache.py",
    ),
    Mutation(
        "held-out-frames", "p2o_train", "leaked truth", "toolkit/p2o_train/train.py",
        "for path in chosen(number, True)]", "for path in chosen(number, False)]", f"{_T}/learn/train.py",
    ),
    Mutation(
        "far-points-on-top", "draw", "flipped sign", f"{_T}/draw/overlay.py",
        "np.argsort(-xyz[seen, 2]", "np.argsort(xyz[seen, 2]",
    ),
    Mutation(
        "exit-code", "cli", "lost exit code", f"{_T}/cli/__init__.py",
        "return problem.exit_code", "return 1",
    ),
    Mutation(
        "check-exit-code", "cli", "lost exit code", f"{_T}/cli/check.py",
        "return 1 if check_result.holding in bad else 0", "return 0",
        "", "return 1 if found.holding in bad else 0",
    ),
    Mutation(
        "wrong-derivatives-pass", "p2o_testing", "dropped guard", "toolkit/p2o_testing/checks/matchers.py",
        "require(wrong <= 0.1,", "require(wrong <= 1.0,", f"{_T}/testing/checks/matchers.py",
    ),
    Mutation(
        "alarms-ignore-their-rank", "p2o_fleet", "wrong statistics", "toolkit/p2o_fleet/statistics.py",
        "np.log(count / rate) - np.log(np.arange(1, count + 1))", "np.log(count / rate)",
    ),
    Mutation(
        "edge-to-the-parent", "p2o_rig", "flipped sign", "toolkit/p2o_rig/sensor_graph.py",
        "(-1.0, 1.0), strict=True", "(1.0, -1.0), strict=True",
    ),
    Mutation(
        "start-not-in-key", "p2o_study", "wrong key", "toolkit/p2o_study/cells.py",
        "content_hash([method.key, group.content, start])", "content_hash([method.key, group.content])",
        f"{_T}/study/cells.py",
    ),
    Mutation(
        "signed-mean", "p2o_study", "flipped sign", "toolkit/p2o_study/tally.py",
        "known.append(abs(value))", "known.append(value)", f"{_T}/study/tally.py",
    ),
    Mutation(
        "interval-ends", "p2o_study", "wrong formula", "toolkit/p2o_study/report/bootstrap.py",
        "[(1 - SHARE) / 2, (1 + SHARE) / 2]", "[1 - SHARE, SHARE]", f"{_T}/report/bootstrap.py",
    ),
    Mutation(
        "truth-in-range-image", "p2o_pages", "leaked truth", "toolkit/p2o_pages/pick/range_image.py",
        "_ROUNDED_DEG * round(float(np.degrees(np.arctan2(ahead[1], ahead[0]))) / _ROUNDED_DEG)",
        "float(np.degrees(np.arctan2(ahead[1], ahead[0])))",
        f"{_T}/picks/range_image.py",
    ),
    Mutation(
        "pose-jumps", "p2o_pages", "lost state", "toolkit/p2o_pages/view/session.py",
        "self._base, self.nudge = self.pose, Nudge(axes)", "self.nudge = Nudge(axes)", f"{_T}/viewer/session.py",
    ),
    Mutation(
        "depth-subpixel", "p2o_plugins/image", "flipped sign", f"{_P}/image/depth.py",
        "uv + 0.5 * background[side]", "uv - 0.5 * background[side]",
    ),
    Mutation(
        "corrected-twice", "p2o_plugins/cloud", "dropped guard", f"{_P}/cloud/jumps.py",
        "measured_s = sweep.cloud.time_s if sweep.cloud.twist is None else None", "measured_s = sweep.cloud.time_s",
        f"{_P}/cloud/rings.py",
        "measured_s = cloud.time_s if cloud.twist is None else None", "measured_s = cloud.time_s",
    ),
    Mutation(
        "lever-arm", "p2o_plugins/cloud", "flipped sign", f"{_P}/cloud/sensor_place.py",
        "twist[3:] + np.cross(turning, place)", "twist[3:] - np.cross(turning, place)",
    ),
    Mutation(
        "all-sides", "p2o_plugins/match", "ignored option", f"{_P}/match/ogm.py",
        "[side for side in p2o.SIDES if side.letter in options.sides]", "[*p2o.SIDES]",
    ),
    Mutation(
        "box-does-not-shrink", "p2o_plugins/solve", "ignored option", f"{_P}/solve/random_shrink.py",
        "shifts / options.shrink_shifts", "shifts",
    ),
    Mutation(
        "grid-in-degrees", "p2o_plugins/initialize", "wrong unit", f"{_P}/initialize/grid.py",
        "[np.radians(turns), np.zeros_like(turns)]", "[turns, np.zeros_like(turns)]",
    ),
    Mutation(
        "farthest-points", "p2o_plugins/accumulate", "ignored option", f"{_P}/accumulate/joining.py",
        "max_range_m=options.max_range_m)", "max_range_m=None)",
    ),
    Mutation(
        "clockwise-times", "p2o_datasets", "flipped sign", "plugins/p2o_datasets/velodyne_file.py",
        "-azimuth / (2 * np.pi) * sweep_s", "azimuth / (2 * np.pi) * sweep_s", f"{_P}/data/velodyne_file.py",
    ),
    Mutation(
        "tree-downwards", "p2o_formats", "inverted transform", "plugins/p2o_formats/frame_tree.py",
        "(step if upwards else se3.inverse(step))", "step",
        f"{_T}/bags/frame_tree.py",
        old_find="yield child, se3.inverse(matrix(transform))", old_replace="yield child, matrix(transform)",
    ),
    Mutation(
        "big-endian", "p2o_datasets", "inverted condition", "plugins/p2o_datasets/bags/point_columns.py",
        'order = ">" if message.is_bigendian', 'order = "<" if message.is_bigendian',
        f"{_T}/bags/point_columns.py",
    ),
    Mutation(
        "colmap-half-pixel", "p2o_formats", "off by one", "plugins/p2o_formats/colmap.py",
        "tuple(params.tolist()), -0.5)", "tuple(params.tolist()), 0.0)", f"{_T}/formats/colmap.py",
    ),
    Mutation(
        "koide-direction", "p2o_formats", "inverted transform", "plugins/p2o_formats/koide.py",
        "lidar_from_camera = se3.inverse(calibration.extrinsic())", "lidar_from_camera = calibration.extrinsic()",
        f"{_T}/formats/koide.py",
    ),
    Mutation(
        "spin-direction", "p2o_sim", "flipped sign", "plugins/p2o_sim/sensing/lidar.py",
        "-share if lidar.clockwise else share", "share if lidar.clockwise else -share",
        f"{_T}/simulate/lidar.py",
    ),
    Mutation(
        "depth-in-metres", "p2o_sim", "wrong unit", "plugins/p2o_sim/write/vkitti2.py",
        "np.rint(100.0 * np.asarray(image.depth_m))", "np.rint(np.asarray(image.depth_m))",
        f"{_T}/simulate/write_vkitti2.py",
    ),
    Mutation(
        "mirrored-rotation", "p2o_baselines", "dropped guard", f"{_B}/boards/pairing.py",
        "u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt", "u @ vt",
        f"{_B}/boards/closed_form.py",
    ),
    Mutation(
        "information-slope", "p2o_baselines", "flipped sign", f"{_B}/information.py",
        "[-p2o.se3.skew(xyz[seen])", "[p2o.se3.skew(xyz[seen])",
    ),
)  # fmt: skip


@dataclass
class Outcome:
    """What became of a fault: caught, survived, or void, if tests fail without it, too."""

    name: str
    room: str
    kind: str
    path: str
    outcome: str = ""
    stage: int = 0
    test: str = ""
    seconds: float = 0.0
    stage_1: list[str] = field(default_factory=list)


def is_new(tree: Path) -> bool:
    """Return whether a tree has the layout of several packages."""
    return (tree / "plugins/p2o_sim").is_dir()


def test_files(tree: Path) -> list[str]:
    """Return the paths of all test files of a tree."""
    return sorted(path.relative_to(tree).as_posix() for path in (tree / "tests").rglob("test_*.py"))


def module_of(path: str) -> str:
    """Return the dotted name of a source file such as toolkit/p2o/geometry/se3.py."""
    return ".".join(Path(path).with_suffix("").parts[1:]).removesuffix(".__init__")


def imported(source: str) -> Counter[str]:
    """Return how often a source text names modules in its imports: `from a.b import c` names a.b and a.b.c."""
    names: Counter[str] = Counter()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
    return names


def nearest_tests(tree: Path, path: str) -> list[str]:
    """Return the test files of stage 1: those named after the module, then some of those that import it."""
    module = module_of(path)
    stem = module.rpartition(".")[2]
    files = test_files(tree)
    named = [file for name in (f"test_{stem}", f"test_{stem}_command") for file in files if Path(file).stem == name]
    counts = {
        file: imported((tree / file).read_text(encoding="utf-8"))[module]
        for file in files
        if file not in named and Path(file).stem.removeprefix("test_") not in _SLOW
    }
    importers = sorted((file for file, count in counts.items() if count), key=lambda file: (-counts[file], file))
    near = named + importers[:_MOST_IMPORTERS]
    folders = set(Path(path).parent.parts[-1:])
    room = [file for file in counts if file not in near and folders & set(Path(file).parent.parts)]
    return near if len(near) >= _FEW else near + room[: _MOST_IMPORTERS - len(near)]


def marker(tree: Path) -> list[str]:
    """Return the arguments of pytest that leave out what `make test` leaves out."""
    return ["-m", "not system"] if '"system:' in (tree / "pyproject.toml").read_text(encoding="utf-8") else []


def copied(tree: Path, to: Path) -> Path:
    """Copy the tracked files of a tree, and link its ignored folder build, which has the real frames."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=tree, capture_output=True, check=True).stdout.decode()
    for name in filter(None, listed.split("\0")):
        if (tree / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(tree / name, to / name)
    if (tree / "build").exists():
        (to / "build").symlink_to((tree / "build").resolve())
    return to


def environment(tree: Path, folder: Path) -> dict[str, str]:
    """Return the environment of tests: the sources of the tree before those of the distribution, no kept features."""
    paths = [str(tree / name) for name in _SOURCES]
    own = {
        "PYTHONPATH": os.pathsep.join([*paths, str(tree)]),
        "P2O_CACHE": str(folder / "cache"),
        "P2O_STRICT": "1",
        "OMP_NUM_THREADS": "1",
        # A fault of the same length in the same second would be hidden by the compiled file.
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    return {**os.environ, **own}


class Tree:
    """A copy of a tree in which tests run with one fault at a time."""

    def __init__(self, source: Path, folder: Path, python: str) -> None:
        self.root, self.folder, self.python = copied(source, folder / "tree"), folder, python

    def tests(self, files: Iterable[str], limit_s: float, without: Iterable[str] = ()) -> tuple[str, list[str]]:
        """Run tests up to the first failure; return "passed", "failed", "hung" or a fault of pytest, and the failures.

        `without` are ids of tests to leave out.
        """
        shutil.rmtree(self.folder / "cache", ignore_errors=True)
        options = ["-q", "-x", "-rfE", "-p", "no:cacheprovider", "-p", "no:randomly", *marker(self.root)]
        left_out = [word for test in without for word in ("--deselect", test)]
        command = [self.python, "-m", "pytest", *options, *left_out, *files]
        try:
            done = subprocess.run(
                command, cwd=self.root, env=environment(self.root, self.folder), timeout=limit_s,
                capture_output=True, text=True, errors="replace",
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "hung", []
        failures = _FAILED.findall(done.stdout)
        if done.returncode in (0, 5):
            return "passed", []
        if done.returncode in (1, 2) or (done.returncode < 0 or done.returncode > 5):
            return "failed", failures
        return f"pytest: exit status {done.returncode}: {(done.stderr or done.stdout).strip()[-300:]}", []

    def origin(self) -> str:
        """Return where the interpreter of the tests finds the package p2o."""
        command = [self.python, "-c", "import p2o; print(p2o.__file__)"]
        environ = environment(self.root, self.folder)
        return subprocess.run(command, cwd=self.root, env=environ, capture_output=True, text=True).stdout.strip()


class Sound:
    """Tests that fail without any fault, by file; each file is run once in a copy of its own."""

    def __init__(self, tree: Tree) -> None:
        self._tree, self._failing, self._lock = tree, {}, threading.Lock()
        self._failing: dict[str, list[str]]

    def failing(self, test: str) -> list[str]:
        """Return the tests in the file of a test that fail without the fault."""
        file = test.partition("::")[0]
        with self._lock:
            if file not in self._failing:
                failing: list[str] = []
                while (status := self._tree.tests([file], _LIMITS_S[1], failing))[0] == "failed" and status[1]:
                    failing += status[1]
                self._failing[file] = failing if status[0] == "passed" else [*failing, file]
            return self._failing[file]


def tried(mutation: Mutation, tree: Tree, sound: Sound, last_stage: int) -> Outcome:
    """Inject a fault, run the tests, and undo it."""
    path, find, replace = mutation.place(tree.root)
    out = Outcome(mutation.name, mutation.room, mutation.kind, path)
    near = nearest_tests(tree.root, path)
    out.stage_1 = near
    others = [file for file in test_files(tree.root) if file not in near]
    file = tree.root / path
    text = file.read_text(encoding="utf-8")
    began = time.monotonic()
    file.write_text(text.replace(find, replace), encoding="utf-8")
    try:
        for stage, files in ((1, near), (2, others)):
            if stage > last_stage or not files:
                continue
            out.stage = stage
            out.outcome, out.test = _judged(tree, sound, files, _LIMITS_S[stage - 1])
            if out.outcome != "survived":
                break
    finally:
        file.write_text(text, encoding="utf-8")
    out.outcome = out.outcome or "survived"
    out.seconds = round(time.monotonic() - began, 1)
    return out


def _judged(tree: Tree, sound: Sound, files: Sequence[str], limit_s: float) -> tuple[str, str]:
    """Return the outcome of one stage, and the first test that fails because of the fault."""
    without: list[str] = []
    while True:
        status, failures = tree.tests(files, limit_s, without)
        if status == "passed":
            return "survived", ""
        if status == "hung":
            return "caught", "(the tests hang)"
        if status != "failed":
            return "void", status
        if not failures:
            return "caught", "(the process ends)"
        also = sound.failing(failures[0])
        if failures[0] not in also and failures[0].partition("::")[0] not in also:
            return "caught", failures[0]
        if failures[0] in without:
            return "void", f"{failures[0]} fails without the fault, too"
        without += also


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the outcomes as a table, and the share of caught faults."""
    lines = [f"{'fault':<24} {'room':<24} {'kind':<20} {'outcome':<9} {'stage':>5} {'s':>7}  test"]
    for o in outcomes:
        head = f"{o.name:<24} {o.room:<24} {o.kind:<20} {o.outcome:<9}"
        lines.append(f"{head} {o.stage:>5} {o.seconds:>7.1f}  {o.test}")
    counts = Counter(o.outcome for o in outcomes)
    share = 100 * counts["caught"] / max(1, len(outcomes) - counts["void"])
    lines.append(
        f"{counts['caught']} of {len(outcomes)} faults are caught, {counts['survived']} survive, {counts['void']} are"
        f" void: {share:.1f} %"
    )
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Try the faults and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tree", type=Path, default=Path(__file__).parents[1], help="The source tree (default: this).")
    parser.add_argument("--python", default=sys.executable, help="The interpreter that runs its tests.")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="Names of faults.")
    parser.add_argument("--jobs", type=int, default=1, help="Number of copies of the tree that work at a time.")
    parser.add_argument("--stage", type=int, choices=(1, 2), default=2, help="The last stage to run.")
    parser.add_argument("--check", action="store_true", help="Only see whether every text is there exactly once.")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="Where to write the outcomes.")
    words = parser.parse_args(argv)
    tree = words.tree.resolve()
    unknown = set(words.only or ()) - {mutation.name for mutation in MUTATIONS}
    if unknown:
        parser.error(f"unknown faults: {', '.join(sorted(unknown))}")
    chosen = [mutation for mutation in MUTATIONS if not words.only or mutation.name in words.only]
    reasons = [reason for mutation in chosen if (reason := mutation.misfit(tree))]
    for reason in reasons:
        print(reason, file=sys.stderr)
    if reasons or words.check:
        print(f"{len(chosen) - len(reasons)} of {len(chosen)} faults fit {tree}")
        return 2 if reasons else 0
    with tempfile.TemporaryDirectory(prefix="p2o-mutations-") as folder:
        copies = [Tree(tree, Path(folder) / str(number), words.python) for number in range(words.jobs + 1)]
        if not Path(copies[0].origin()).is_relative_to(copies[0].root):
            print(f"{words.python} takes p2o from {copies[0].origin()}, not from the copy", file=sys.stderr)
            return 2
        sound, free = Sound(copies.pop()), list(copies)
        outcomes: list[Outcome] = []

        def one(mutation: Mutation) -> Outcome:
            mine = free.pop()
            try:
                outcome = tried(mutation, mine, sound, words.stage)
            finally:
                free.append(mine)
            print(f"{outcome.name}: {outcome.outcome}, {outcome.seconds:.0f} s  {outcome.test}", flush=True)
            outcomes.append(outcome)
            if words.out is not None:
                _write(words.out, tree, words.stage, outcomes)
            return outcome

        with ThreadPoolExecutor(words.jobs) as pool:
            outcomes = list(pool.map(one, chosen))
    print(table(outcomes))
    if words.out is not None:
        _write(words.out, tree, words.stage, outcomes)
    return 0


def _write(path: Path, tree: Path, stage: int, outcomes: Sequence[Outcome]) -> None:
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=tree, capture_output=True, text=True).stdout.strip()
    counts = Counter(outcome.outcome for outcome in outcomes)
    content = {"commit": commit, "last_stage": stage, **counts, "faults": [asdict(outcome) for outcome in outcomes]}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
