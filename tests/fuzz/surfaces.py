"""The doors of p2o, each with a way to draw a case: files in the folder `in`, and the command that meets them."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import yaml
from p2o.cli import main

from tests.fuzz import files
from tests.fuzz.bases import RUN, Bases
from tests.fuzz.mutate import NUMBERS, WORDS, bytes_of, tree_of

OUT = "out"
"""What commands are given as --out; it lies in the folder of the case."""


@dataclass(frozen=True)
class Case:
    """A command of p2o, or a reader called in Python; `result` is a file of results that has to be right after it.

    `hangs` is a file that the case writes if it begins to hang; it is then interrupted as by Ctrl-C.
    """

    argv: tuple[str, ...] = ()
    call: Callable[[], int] | None = None
    hangs: str = ""

    def __call__(self) -> int:
        """Return the exit status."""
        if self.call is not None:
            return self.call()
        sys.argv = ["p2o", *self.argv]
        return main()


Draw = Callable[[Random, Bases, Path], Case]


def sweep(rng: Random, bases: Bases, home: Path) -> Case:
    """A sweep of any format, odd or damaged."""
    frame = frame_of(bases, home, without=("cloud.npz",))
    suffix = rng.choice(files.CLOUDS)
    data = files.cloud(rng, suffix)
    name = f"cloud{suffix}"
    (frame / name).write_bytes(bytes_of(rng, data) if rng.random() < 0.6 else data)
    said_in(frame, cloud=name, **({"twist": None} if rng.random() < 0.7 else {}))
    if rng.random() < 0.05:
        _swap(rng, frame / name)
    return read_or_run(rng, "folder:in")


def picture(rng: Random, bases: Bases, home: Path) -> Case:
    """An image, a right image or a depth, odd or damaged."""
    frame = frame_of(bases, home)
    what = rng.choice(("image", "image", "right", "depth"))
    if what == "depth":
        name = rng.choice(("depth.npy", "depth.png"))
        data = (frame / "depth.npy").read_bytes()
        if name == "depth.png":
            data = files.image(rng, ".png")
        elif rng.random() < 0.4:
            data = files.npy(rng, files.points(), odd=True)
        (frame / "depth.npy").unlink()
    else:
        suffix = rng.choice(files.IMAGES)
        name = f"{what}{suffix}"
        data = files.image(rng, suffix) if rng.random() < 0.8 else (frame / f"{what}.png").read_bytes()
        (frame / f"{what}.png").unlink()
    (frame / name).write_bytes(bytes_of(rng, data) if rng.random() < 0.5 else data)
    said_in(frame, **{what: name})
    if rng.random() < 0.05:
        _swap(rng, frame / name)
    return read_or_run(rng, "folder:in")


def frame_file(rng: Random, bases: Bases, home: Path) -> Case:
    """A frame.yaml of wrong values, or wrong bytes."""
    frame = frame_of(bases, home)
    path = frame / "frame.yaml"
    said = yaml.safe_load(path.read_text(encoding="utf-8"))
    said |= rng.choice(_FORMS)
    if rng.random() < 0.6:
        said = tree_of(rng, said)
    try:
        text = yaml.safe_dump(said, allow_unicode=rng.random() < 0.5).encode("utf-8", "surrogatepass")
    except (yaml.YAMLError, UnicodeEncodeError):
        text = json.dumps(said).encode()
    path.write_bytes(bytes_of(rng, text) if rng.random() < 0.5 else text)
    return read_or_run(rng, "folder:in")


def rig(rng: Random, bases: Bases, home: Path) -> Case:
    """A rig file of wrong values, or wrong bytes."""
    frame_of(bases, home)
    said = tree_of(rng, rng.choice(_RIGS)) if rng.random() < 0.8 else rng.choice(_RIGS)
    name = rng.choice(("rig.yaml", "rig.json"))
    try:
        text = json.dumps(said) if name == "rig.json" else yaml.safe_dump(said)
    except (yaml.YAMLError, UnicodeEncodeError, TypeError):
        text = json.dumps(said, default=str)
    data = text.encode("utf-8", "surrogatepass")
    (home / "in" / name).write_bytes(bytes_of(rng, data) if rng.random() < 0.3 else data)
    return Case(("run", "--data", "folder:in", *RUN, "--rig", f"in/{name}", *rng.choice(((), ("--json",)))))


_EYE = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
_FORMS: tuple[dict[str, Any], ...] = (
    *({}, {}, {"start": _EYE}, {"start": _EYE[:3]}, {"start": [x for row in _EYE for x in row]}),
    {"start": {"rotation_xyzw": [0, 0, 0, 1], "translation_m": [0, 0, 0]}},
    {"start": {"rotation_xyzw": [-0.5, 0.5, -0.5, 0.5001], "translation_m": [0, 0, 0]}},
    {"start": {"rpy_deg": [-90, 0, -90], "translation_m": [0, 0, 0]}},
    {"start": {"lidar_from_camera": _EYE}},
    {"camera": {"width": 160, "height": 96, "K": [[92.0, 0, 80], [0, 92, 48], [0, 0, 1]]}},
    {
        "camera": {
            "width": 160,
            "height": 96,
            "K": [[92.0, 0, 80], [0, 92, 48], [0, 0, 1]],
            "distortion_model": "plumb_bob",
            "D": [0.1, 0, 0, 0, 0],
        }
    },
    {"camera": {"model": "OPENCV_FISHEYE", "width": 160, "height": 96, "params": [92, 92, 80, 48, 0.1, 0, 0, 0]}},
    {"sequence": "drive", "time_s": 1.5, "lidar_world_from_lidar": _EYE, "camera_world_from_camera": _EYE},
    {
        "targets": [
            {"kind": "checkerboard", "columns": 7, "rows": 5, "square_m": 0.1, "width_m": 1.2, "height_m": 0.8},
            {"kind": "holes", "width_m": 1.0, "height_m": 1.0, "holes": [[0.0, 0.0, 0.1]]},
            {"kind": "sphere", "radius_m": 0.3},
            {"kind": "box", "width_m": 0.9, "height_m": 0.7, "depth_m": 0.5},
        ]
    },
)


def layout(rng: Random, bases: Bases, home: Path) -> Case:
    """A folder of a public data set's layout with one file that is damaged, gone, or no file."""
    name, base = rng.choice(sorted(bases.layouts.items()))
    root = home / "in"
    # Hard links are quick; what is changed is written anew.
    shutil.copytree(base, root, copy_function=os.link)
    found = sorted(path for path in root.rglob("*") if path.is_file())
    texts = [path for path in found if path.suffix in (".txt", ".json", ".yaml")] or found
    for _ in range(rng.choice((1, 1, 2))):
        path = rng.choice(texts if rng.random() < 0.6 else found)
        if rng.random() < 0.7:
            data = path.read_bytes()
            path.unlink()
            path.write_bytes(_spoilt(rng, path.suffix, data))
        else:
            path = rng.choice((path, path, path.parent))
            if path != root:
                _swap(rng, path)
        found = sorted(path for path in root.rglob("*") if _small(path)) or found
        texts = [path for path in found if path.suffix in (".txt", ".json", ".yaml")] or found
        if not all(path.exists() for path in texts):
            break
    return read_or_run(rng, f"{name}:in")


def _spoilt(rng: Random, suffix: str, data: bytes) -> bytes:
    """Return a file with wrong bytes, or a table of JSON with wrong values."""
    if suffix != ".json" or rng.random() < 0.3:
        return bytes_of(rng, data)
    return json.dumps(tree_of(rng, json.loads(data)), default=str).encode("utf-8", "surrogatepass")


def bag(rng: Random, bases: Bases, home: Path) -> Case:
    """A bag of any container with bytes that are damaged."""
    base = rng.choice(bases.bags)
    name = f"in/drive{base.suffix}"
    (home / name).write_bytes(bytes_of(rng, base.read_bytes()))
    if rng.random() < 0.05:
        _swap(rng, home / name)
    return bag_case(rng, name)


def bag_case(rng: Random, name: str) -> Case:
    """Return a command that reads a bag."""
    if rng.random() < 0.3:
        return Case(("data", "topics", name, *rng.choice(((), ("--json",)))))
    options = rng.choice(((), ("--set", "data.every_m=0.5"), ("--set", "data.tf=truth")))
    return Case(("data", "check", f"ros:{name}", *options))


def words(rng: Random, bases: Bases, home: Path) -> Case:
    """The words of the command line."""
    frame_of(bases, home)
    (home / OUT / "file").touch()
    command = rng.choice(("run",) * 6 + ("data", "methods", "plugin", "simulate", "labels", "report"))
    argv = [command]
    if command == "data":
        argv += [rng.choice(("list", "check", "check", _word(rng))), _data(rng)]
        argv += ["--frames", _frames(rng)] if rng.random() < 0.5 else []
    elif command == "methods":
        argv += [rng.choice(("ogm", "synthetic", "pipeline", "rings@p2o-calib", _word(rng)))]
        argv += ["--matrix"] if rng.random() < 0.2 else []
    elif command == "plugin":
        argv += rng.choice((["list"], ["check", rng.choice(("given", "json", "kitti", _word(rng)))]))
    elif command == "simulate":
        argv += [OUT, "--layout", rng.choice(("folder", "kitti-raw", "vkitti2", _word(rng)))]
        small = {"width_px": 96, "height_px": 64, "lidar": "vlp-16"}
        argv += [word for name, value in small.items() for word in ("--set", f"{name}={value}")]
        argv += ["--set", _setting(rng, "data", "dataset", "synthetic").partition(".")[2]]
        argv += ["--seed", _number(rng)] if rng.random() < 0.3 else []
    elif command == "labels":
        argv += ["p2ornet", "--data", _data(rng), "--out", OUT]
        argv += ["--frames", _frames(rng)] if rng.random() < 0.3 else []
    elif command == "report":
        shutil.copytree(bases.study / "out", home / OUT / "study")
        argv += [rng.choice(("in", f"{OUT}/study", _word(rng))), "--out", OUT]
        argv += ["--study", _word(rng)] if rng.random() < 0.5 else []
    elif command == "run":
        argv += ["--data", "folder:in", *RUN]
        argv += ["--json"] if rng.random() < 0.7 else []
        for _ in range(rng.choice((1, 1, 2))):
            argv += _run_word(rng)
    return Case(tuple(argv))


def _run_word(rng: Random) -> list[str]:
    how = rng.randrange(14)
    if how < 5:
        stage, kind, name = rng.choice(_STAGES)
        more = [] if name is None else [_FLAG[kind], name] if kind in _FLAG else []
        if kind == "image-extractor":
            more = ["--extractor", f"{name}/rings"]
        return [*more, "--set", _setting(rng, stage, kind, name)]
    return {
        5: lambda: ["--frames", _frames(rng)],
        6: lambda: [
            "--perturb",
            rng.choice(("1deg 0.1m", "1deg,10cm", "180deg 1000m", f"{_number(rng)}deg", "camera @in", _word(rng))),
        ],
        7: lambda: ["--seed", _number(rng), "--perturb", "1deg 0.05m"],
        8: lambda: [
            "--require",
            rng.choice(("trusted", "trusted 1deg 1m", "0deg 0m", f"{_number(rng)}deg 1m", _word(rng))),
        ],
        9: lambda: ["--export", rng.choice(("json:out/r.json", "kitti:out/{frame}.txt", "json:no/r", _word(rng)))],
        10: lambda: ["--data", _data(rng)],
        11: lambda: [
            rng.choice(("--extractor", "--matcher", "--solver", "--init", "--calibrator", "--witness")),
            _word(rng),
        ],
        12: lambda: rng.choice((["--joint"], ["--out", OUT], ["--out", OUT, "--joint"], ["--out", f"{OUT}/file"])),
        13: lambda: ["--set", rng.choice((_word(rng), f"matcher.{_word(rng)}=1", f"pipeline.rounds={_word(rng)}"))],
    }[how]()


_FLAG = {"matcher": "--matcher", "solver": "--solver", "initializer": "--init"}
_STAGES: tuple[tuple[str, str, str | None], ...] = (
    *((("pipeline", "", None),) * 2),
    *(("image", "image-extractor", name) for name in ("stereo", "depth", "p2ornet")),
    ("cloud", "cloud-extractor", "rings"),
    ("matcher", "matcher", "ogm"),
    *(("solver", "solver", name) for name in ("lm", "scipy", "nelder-mead")),
    *(("initializer", "initializer", name) for name in ("search", "grid", "far")),
)


def _setting(rng: Random, stage: str, kind: str, name: str | None) -> str:
    """Return STAGE.FIELD=VALUE for a field of a method, with a value inside its bounds, at them, or beyond."""
    model = _options_of(kind, name)
    if model is None or not model.model_fields:
        return f"{stage}.{_word(rng)}={_word(rng)}"
    shape = model.model_json_schema()["properties"]
    key = rng.choice(sorted(shape))
    return f"{stage}.{key}={_value(rng, shape[key])}"


def _options_of(kind: str, name: str | None) -> Any:
    from p2o.calibration.options import PipelineOptions
    from p2o.host.registry import Registry

    if name is None:
        return PipelineOptions
    return next((o.method.options for o in Registry.load().offers if (o.kind.value, o.name) == (kind, name)), None)


def _value(rng: Random, shape: Mapping[str, Any]) -> str:
    """Return a value for a field of this JSON schema; sizes stay within four times the default: cost is not damage."""
    if rng.random() < 0.4:
        return _word(rng)
    kinds = [shape, *shape.get("anyOf", ())]
    kind = rng.choice(kinds)
    default = shape.get("default")
    if "enum" in kind:
        return str(rng.choice(kind["enum"]))
    if kind.get("type") == "boolean":
        return rng.choice(("true", "false", "1", "maybe"))
    if kind.get("type") in ("number", "integer"):
        if rng.random() < 0.4:
            low, high = (kind.get(end) for end in ("minimum", "maximum"))
            edges = [
                v
                for v in (low, None if low is None else low - 1, None if high is None else high * 2 + 1)
                if v is not None
            ]
            return str(rng.choice([*edges, kind.get("exclusiveMinimum", -1), kind.get("exclusiveMaximum", 0)]))
        size = default if isinstance(default, int | float) and default else 1
        scaled = size * 4 ** rng.uniform(-1, 1)
        return str(round(scaled) if kind["type"] == "integer" else scaled)
    if isinstance(default, list | tuple):
        return json.dumps(tree_of(rng, list(default)), default=str)
    return str(default) if rng.random() < 0.5 else _word(rng)


def _word(rng: Random) -> str:
    # What the shell cannot pass on: a zero byte ends an argument.
    return rng.choice(WORDS).replace("\0", "")


def _number(rng: Random) -> str:
    return rng.choice((str(rng.choice(NUMBERS)), _word(rng)))


def _seeds(rng: Random) -> str:
    """Return seeds; hundreds of them are no wrong input, only more work than a case has time for."""
    said = rng.choice(("1", "0,1", "2-3", _number(rng)))
    return "4" if said in ("255", "256") else said


def _frames(rng: Random) -> str:
    good = ["0", "all", "0-1", ":1", "scene-0000", "-1", "0,1,0", "1-0", "::0", "0-99999999999", ","]
    good += ["@in/scene/frame.yaml"]
    return rng.choice((*good, _word(rng), f"{rng.choice(good)},{_word(rng)}"))


def _data(rng: Random) -> str:
    small = "width_px=96&height_px=64&lidar=vlp-16"
    good = f"folder:in folder:in/scene kitti-raw:in nosuch:in in folder : ? synthetic:?{small}".split()
    odd = rng.choice((_word(rng), f"folder:{_word(rng)}", f"synthetic:?{_word(rng)}={_word(rng)}"))
    return rng.choice((*good, odd, odd, f"synthetic:?{small}&seed={_number(rng)}"))


def study(rng: Random, bases: Bases, home: Path) -> Case:
    """A study file."""
    right = (bases.study / "study.toml").read_bytes()
    by_word = rng.random() < 0.6
    wrong = _toml_of(rng, right.decode()).encode("utf-8", "surrogatepass") if by_word else bytes_of(rng, right)
    wrong = re.sub(rb"(seeds = )25[56]", rb"\g<1>4", wrong)
    (home / "in/study.toml").write_bytes(wrong)
    argv = ["ablate", "in/study.toml", "--out", OUT, "--jobs", "1"]
    argv += ["--seeds", _seeds(rng)] if rng.random() < 0.3 else []
    argv += ["--frames", _frames(rng)] if rng.random() < 0.2 else []
    argv += (
        ["--data", rng.choice((f"folder:{bases.folder}", f"own=folder:{bases.folder}", _data(rng)))]
        if rng.random() < 0.2
        else []
    )
    shutil.copytree(bases.study / "cache", home / "cache", copy_function=os.link, dirs_exist_ok=True)
    return Case(tuple(argv))


_TOML = (
    *("1", "-1", "0", "1.5", "inf", "nan", "9999999999999999999999", "1000000", "true", "[]", "{}"),
    *("2011-09-26", "12:30:00"),
    *('"text"', '""', '"1e9m"', '"180deg 5m"', '"../../x"', '"""long\ntext"""', '"\\u001b[31m"'),
    *('"{matcher.__class__}"', '"{matcher:>99999999}"', '"{use!r}"'),
    *("[1, 2]", "[0, 0]", '["a"]', "[[[[[[[[1]]]]]]]]", "{ a = { b = { c = 1 } } }"),
)


def _toml_of(rng: Random, text: str) -> str:
    """Return a study with values, keys or tables that are changed, doubled or gone."""
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randrange(len(lines))
        key, equals, _ = lines[at].partition("=")
        how = rng.randrange(6)
        if equals and how < 3:
            lines[at] = f"{key}= {rng.choice(_TOML)}"
        elif how == 3:
            lines.insert(
                at, rng.choice((lines[rng.randrange(len(lines))], f"{_word(rng)} = 1", "[[row]]", "[defaults]"))
            )
        elif how == 4 and len(lines) > 1:
            del lines[at]
        else:
            lines[at] = lines[at].replace(
                rng.choice(("matcher", "own", "ogm", "row", "e")), rng.choice(("x", "matchr", "")), 1
            )
    return "\n".join(lines)


def result(rng: Random, bases: Bases, home: Path) -> Case:
    """A result that is read back: by p2o.results, in Python."""
    text = bases.result.read_bytes()
    if rng.random() < 0.7:
        text = json.dumps(tree_of(rng, json.loads(text))).encode("utf-8", "surrogatepass")
    else:
        text = bytes_of(rng, text)
    (home / "in/result.json").write_bytes(text)

    def call() -> int:
        import click
        from p2o.errors import P2OError
        from p2o.files.input_file import read_text
        from p2o.results.result_json import result_from_json, result_to_json

        try:
            read = result_from_json(read_text("in/result.json", "result"))
            Path(OUT, "result.json").write_text(result_to_json(read), encoding="utf-8")
        except P2OError as problem:
            click.echo(f"p2o: error: {problem}", err=True)
            return problem.exit_code
        return 0

    return Case(call=call)


def weights(rng: Random, bases: Bases, home: Path) -> Case:
    """A file of weights: safetensors with wrong headers, shapes or bytes."""
    from p2o_plugins.p2ornet.shipped import weights_named

    data = weights_named("free").path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    head: Any = json.loads(data[8 : 8 + size])
    how = rng.random()
    if how < 0.6:
        new = json.dumps(tree_of(rng, head)).encode("utf-8", "surrogatepass")
        data = len(new).to_bytes(8, "little") + new + data[8 + size :]
    else:
        data = bytes_of(rng, data[: 8 + size]) + data[8 + size :]
    (home / "in/weights.safetensors").write_bytes(data)
    frame_of(bases, home)
    words = ("--extractor", "p2ornet/rings", "--set", "image.weights=in/weights.safetensors")
    return Case(("run", "--data", "folder:in", *RUN, *words))


def pairs(rng: Random, bases: Bases, home: Path) -> Case:
    """A file of picked pairs, JSON or YAML."""
    picks = [{"uv": [8.0 + 14 * i, 10.0 + 37 * i % 70], "xyz": [4.0 + 3 * i % 9, 3.0 - i, i % 3 - 1]} for i in range(9)]
    tree: Any = {"frames": {"scene-0000": picks, "elsewhere": picks[:2]}}
    tree = tree_of(rng, tree) if rng.random() < 0.7 else tree
    suffix = rng.choice((".yaml", ".json"))
    try:
        text = json.dumps(tree) if suffix == ".json" else yaml.safe_dump(tree, allow_unicode=rng.random() < 0.5)
    except yaml.YAMLError:
        text = json.dumps(tree)
    data = text.encode("utf-8", "surrogatepass")
    path = home / f"in/pairs{suffix}"
    path.write_bytes(bytes_of(rng, data) if rng.random() < 0.5 else data)
    if rng.random() < 0.05:
        _swap(rng, path)
    argv = ("run", "--data", f"folder:{bases.folder}", "--frames", "0", "--calibrator", "picked", "--witness", "none")
    return Case((*argv, "--set", f"calibrator.pairs=in/pairs{suffix}"))


def calibrations() -> dict[Any, bytes]:
    """Return a calibration file of every form that can be written."""
    from p2o import Camera
    from p2o.calibration_files.calibration import Calibration
    from p2o_formats.formats import WRITTEN

    camera = Camera("OPENCV", 160, 96, (92.0, 93.0, 80.0, 48.0, 0.1, 0.01, 0.0, 0.001))
    pose = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    return {form: form.written(Calibration(camera, pose)) for form in WRITTEN.values()}


def calibration(rng: Random, bases: Bases, home: Path) -> Case:
    """A calibration file of any form, with wrong bytes or values, converted to any other."""
    written = calibrations()
    form, data = rng.choice(list(written.items()))
    name = form.name
    tree = None
    if form.suffix in (".json", ".yaml") and name != "opencv" and rng.random() < 0.6:
        tree = tree_of(rng, yaml.safe_load(data))
    if tree is None:
        data = bytes_of(rng, data)
    else:
        try:
            data = json.dumps(tree).encode("utf-8", "surrogatepass")
        except (TypeError, ValueError):
            data = yaml.safe_dump(str(tree)).encode("utf-8", "surrogatepass")
    path = home / f"in/calibration{form.suffix}"
    path.write_bytes(data)
    if rng.random() < 0.05:
        _swap(rng, path)
    said = rng.choice(
        ("", "", "", "#cam0", "#P2", "?width=640&height=480", f"?camera_frame={_word(rng)}", f"#{_word(rng)}")
    )
    to = rng.choice((*(form.name for form in written), f"ros2?camera_frame={_word(rng)}", "ros2?form=urdf", _word(rng)))
    return Case(("convert", f"in/{path.name}{said}", f"{OUT}/calibration", "--to", to))


_RIGS: tuple[dict[str, Any], ...] = (
    {"cameras": {"A": {"frames": ["scene*"]}}},
    {"cameras": {"A": {"frames": ["scene"], "camera_from_body": _EYE}}, "body_from_lidar": _EYE},
    {"cameras": {"scene": {"body_from_camera": {"rpy_deg": [-90, 0, -90], "translation_m": [0, 0, 0]}}}},
    {"scene": {"camera_from_lidar": _EYE, "image_before_sweep_s": 0.01}},
    {
        "reference": "A",
        "twist": [0, 0, 0.1, 5, 0, 0],
        "cameras": {"A": {"frames": ["*"]}, "B": {"camera_from_camera": _EYE, "frames": ["b*"]}},
    },
)


def frame_of(bases: Bases, home: Path, without: Sequence[str] = ()) -> Path:
    frame = home / "in/scene"
    shutil.copytree(bases.folder / "scene-0000", frame, ignore=lambda *_: without)
    return frame


def said_in(frame: Path, **values: Any) -> None:
    """Change what frame.yaml says; None takes a key away."""
    path = frame / "frame.yaml"
    said = {**yaml.safe_load(path.read_text(encoding="utf-8")), **values}
    path.write_text(yaml.safe_dump({k: v for k, v in said.items() if v is not None}), encoding="utf-8")


def _swap(rng: Random, path: Path) -> None:
    """Put something else in the place of a file or folder."""
    how = rng.randrange(9)
    if how == 8:
        name = rng.choice(("other", "0000000000x", "²", "a b", "\udcff", "x" * 200, "\x1b[31m", "-1")) + path.suffix
        path.rename(path.with_name(name))
        return
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    if how == 1:
        path.mkdir()
    elif how == 2:
        os.mkfifo(path)
    elif how == 3:
        path.symlink_to("/dev/zero")
    elif how == 4:
        path.symlink_to(path)
    elif how == 5:
        path.symlink_to("/etc/passwd")
    elif how == 6:
        path.touch()
    elif how == 7:
        with path.open("wb") as file:
            file.truncate(1 << math.floor(rng.uniform(20, 42)))


def _small(path: Path) -> bool:
    """True for what a case may read itself: no link, and no file that says it is huge."""
    return path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 26


def read_or_run(rng: Random, data: str) -> Case:
    """Return a command that reads the data, or calibrates its first frame."""
    how = rng.random()
    if how < 0.65:
        return Case(("data", "check", data))
    more = ("--json",) if how < 0.85 else ("--out", OUT) if how < 0.9 else ()
    return Case(("run", "--data", data, "--frames", "0", *RUN, *more))
