"""Readers of calibration files are plugins: the surest recognises a file first, and a faulty one is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Camera, InputError, Method, PluginError, Registry, UnknownNameError
from p2o.calibration_files.calibration import Calibration, CalibrationReader, Reading, Source
from p2o.cli import main
from p2o.files.input_file import naming
from p2o.host.calibration_file import (
    names_file,
    read_calibration,
    read_calibration_file,
    read_initial_guess,
    recognised,
)
from p2o.run.rig import parse_rig

TESTS = Path(__file__).parents[2]
PLUGIN = TESTS / "example_plugins/calibration_reader.py"
ACME = b"acme x_m,y_m,z_m,qx,qy,qz,qw\n0.1,-0.2,-0.3,0.5,-0.5,0.5,0.5\n"
POSE = p2o.se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0.1, -0.2, -0.3])
SPY = ["--calibrator", "spy", "--witness", "none", "--plugin", str(TESTS / "stage_plugin.py")]


class Reader(CalibrationReader):
    """A reader of any file, whose answers are given."""

    def __init__(self, read: Callable[[Source], Any], recognises: Any = True, rank: Any = 50) -> None:
        self._read, self._recognises, self.rank = read, recognises, rank

    def recognises(self, source: Source) -> bool:
        return self._recognises(source) if callable(self._recognises) else self._recognises

    def read(self, source: Source) -> Calibration:
        return self._read(source)

    def example(self) -> bytes:
        return b"anything"


def registry(options: Any = Reading, build: Any = None, **readers: Any) -> Registry:
    """Return a registry of readers by name; `build` takes the place of what returns them."""

    class Plugin:
        @p2o.hookimpl
        def p2o_calibration_readers(self) -> list[Method]:
            return [
                Method(name=name, build=build or (lambda _, r=r: r), options=options, summary="A test.")
                for name, r in readers.items()
            ]

    return Registry.of(acme=Plugin())


@pytest.fixture(autouse=True)
def _no_plugin_file_outlives_its_test(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("p2o.host.registry._file_plugins", {})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "pose.acme"
    path.write_bytes(ACME)
    return path


# ---- a reader of a plugin file


def test_convert_reads_a_format_of_a_plugin_file(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = path.with_name("pose.yaml")
    words = ["convert", str(path), str(out), "--to", "text"]
    assert main(words) == 2
    assert "no calibration reader recognises this file" in capsys.readouterr().err
    assert main([*words, "--plugin", str(PLUGIN)]) == 0
    np.testing.assert_allclose(read_calibration_file(out).extrinsic(), POSE, atol=1e-12)
    assert main(["convert", f"{path}?scale=10", *words[2:], "--plugin", str(PLUGIN)]) == 0
    np.testing.assert_allclose(read_calibration_file(out).extrinsic()[:3, 3], 10 * POSE[:3, 3], atol=1e-12)


def test_a_start_and_a_rig_file_are_read_by_it(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = "synthetic:?width_px=160&height_px=64&lidar=vlp-16&right=false"
    assert main(["run", "--data", data, *SPY, "--plugin", str(PLUGIN), "--json", "--start", str(path)]) == 0
    [row] = json.loads(capsys.readouterr().out)["results"]
    np.testing.assert_allclose(row["camera_from_lidar"], POSE, atol=1e-12)
    known = Registry.load(extra_files=[PLUGIN], environ={})
    np.testing.assert_allclose(read_initial_guess(str(path), registry=known)[0], POSE, atol=1e-12)
    rig = parse_rig({"LEFT": {"camera_from_lidar": path.name}}, path.with_name("rig.yaml"), known)
    np.testing.assert_allclose(rig.camera_from_body["LEFT"], POSE, atol=1e-12)


def test_a_data_set_reads_files_by_the_plugin_files_of_the_process(path: Path) -> None:
    """Data sets see no registry: they take the installed readers and those of plugin files that were loaded."""
    Registry.load(extra_files=[PLUGIN], environ={})
    names = {offer.name for offer in Registry.of_process().of_kind(p2o.Kind.CALIBRATION_READER)}
    assert {"acme", "kalibr"} <= names
    np.testing.assert_allclose(read_calibration(path.name, place=path.with_name).extrinsic(), POSE, atol=1e-12)


def test_methods_and_help_list_readers(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["methods", "--plugin", str(PLUGIN)]) == 0
    listed = capsys.readouterr().out
    assert "calibration readers\n" in listed
    assert "acme@calibration_reader.py" in listed
    assert main(["methods", "acme", "--plugin", str(PLUGIN)]) == 0
    assert "options  (FILE?form=acme&NAME=VALUE)" in capsys.readouterr().out
    assert main(["convert", "--help"]) == 0
    help_text = capsys.readouterr().out
    known = Registry.load(environ={}).of_kind(p2o.Kind.CALIBRATION_READER)
    assert len(known) >= 15
    assert all(offer.name in help_text.partition("Forms:")[2] for offer in known)


def test_check_plugin_checks_a_reader(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plugin", "check", "calibration_reader.py", "--plugin", str(PLUGIN)]) == 0
    told = capsys.readouterr().out
    assert "ok    calibration reader acme: the_example_is_recognised" in told
    broken = tmp_path / "broken_reader.py"
    broken.write_text(PLUGIN.read_text().replace("return source.text.startswith(HEADER)", "return True"))
    assert main(["plugin", "check", "broken_reader.py", "--plugin", str(broken)]) == 1
    assert "FAIL  calibration reader acme: other_files_are_not_recognised" in capsys.readouterr().out


# ---- which reader


def test_the_reader_of_the_lowest_rank_is_asked_first(path: Path) -> None:
    asked: list[str] = []

    def answer(name: str, value: bool) -> Callable[[Source], bool]:
        def recognises(_: Source) -> bool:
            asked.append(name)
            return value

        return recognises

    known = registry(
        a=Reader(lambda _: None, answer("a", True), rank=90),
        b=Reader(lambda _: None, answer("b", True), rank=20),
        c=Reader(lambda _: None, answer("c", False), rank=10),
    )
    assert recognised(Source.of(path), known).name == "b"
    assert asked == ["c", "b"]


def test_a_reader_whose_package_is_missing_costs_its_own_format_only(path: Path) -> None:
    def unavailable(_: Any) -> Any:
        import no_such_package  # noqa: F401

    absent = registry(build=unavailable, absent=None)
    good = Registry.load(extra_files=[PLUGIN], environ={"P2O_PLUGINS": ""})
    both = Registry((*absent.plugins, *good.plugins))
    assert read_calibration_file(path, registry=both).parts == {"extrinsic"}
    with pytest.raises(InputError, match=r"no calibration reader.*needs the package no_such_package"):
        read_calibration_file(path, registry=absent)


def test_unknown_forms_and_fields_are_refused(path: Path) -> None:
    known = Registry.load(extra_files=[PLUGIN], environ={})
    with pytest.raises(UnknownNameError, match=r"unknown calibration reader 'kalibrr'.*did you mean kalibr"):
        read_calibration(f"{path}?form=kalibrr", registry=known)
    with pytest.raises(UnknownNameError, match="unknown reading option 'nosuch'"):
        read_calibration(f"{path}?nosuch=1", registry=known)
    with pytest.raises(InputError, match="scale is out of bounds"):
        read_calibration(f"{path}?scale=-1", registry=known)
    with pytest.raises(InputError, match="name is given twice"):
        read_calibration(f"{path}#a?name=b", registry=known)
    with pytest.raises(InputError, match="expected an installed plugin that reads calibration files"):
        read_calibration_file(path, registry=Registry())


@pytest.mark.parametrize(
    ("text", "file"),
    [
        ("calib.json", True),
        ("a b/pose.npy?direction=lidar_from_camera", True),
        ("camchain.yaml#cam0", True),
        ("roughly x forward, z up; camera 0.5", False),
        ("Roughly a.json", False),
        ("roughly.json", True),
        ("ahead", False),
    ],
)
def test_a_start_is_a_file_or_a_description(text: str, file: bool) -> None:
    assert names_file(text) is file


# ---- faulty readers


def fail(_: Source) -> Any:
    raise KeyError("nothing there")


def mirrored(_: Source) -> Calibration:
    return Calibration(camera_from_lidar=np.diag([1.0, 1.0, -1.0, 1.0]))


@pytest.mark.parametrize(
    ("reader", "message"),
    [
        (Reader(fail), "raised KeyError while reading"),
        (Reader(lambda _: np.eye(4)), "returned ndarray; expected p2o.Calibration"),
        (Reader(lambda _: Calibration(camera=np.eye(3))), "returned ndarray; expected p2o.Camera"),  # type: ignore[arg-type]
        (Reader(lambda _: Calibration(camera_from_lidar=np.eye(4), remarks="so")), "are not texts"),  # type: ignore[arg-type]
        (
            Reader(lambda _: Calibration(camera_from_lidar=np.full((4, 4), np.nan))),
            "as an invalid calibration: camera_from_lidar",
        ),
        (Reader(mirrored), "as an invalid calibration: the rotation of camera_from_lidar mirrors space"),
        (Reader(lambda _: Calibration(Camera.pinhole(-1, 1, 1, 1, 2, 2))), "as an invalid calibration"),
        (Reader(fail, recognises=fail), "raised KeyError while recognising"),
        (Reader(fail, recognises="yes"), "recognises returned str; expected True or False"),
        (Reader(fail, rank="first"), "its rank is 'first'"),
        (object(), "build returned object; expected a CalibrationReader"),
    ],
)
def test_a_faulty_reader_is_named(path: Path, reader: Any, message: str) -> None:
    with pytest.raises(PluginError, match=message) as caught:
        read_calibration_file(path, registry=registry(wrong=reader))
    assert "plugin acme: calibration reader 'wrong'" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_wrong_content_is_the_fault_of_the_file(path: Path) -> None:
    def read(source: Source) -> Calibration:
        with naming(source.path):
            return mirrored(source)

    with pytest.raises(InputError, match=r"pose\.acme: .*camera_from_lidar"):
        read_calibration_file(path, registry=registry(right=Reader(read)))
    empty = registry(right=Reader(lambda _: Calibration(remarks=("nothing in it",))))
    with pytest.raises(InputError, match="this right file holds neither a camera nor an extrinsic; got nothing in it"):
        read_calibration_file(path, registry=empty)


class Required(p2o.Options):
    """Options without a default."""

    size: int = p2o.field(..., help="How many.")


def test_options_without_default_are_a_fault_of_the_plugin(path: Path) -> None:
    with pytest.raises(PluginError, match=r"plugin acme: calibration reader 'wrong': .*size"):
        read_calibration_file(path, registry=registry(Required, wrong=Reader(fail)))
