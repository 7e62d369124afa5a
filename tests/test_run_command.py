"""`p2o run` loses nothing: bad frames among good ones, names that clash, disks that fill up, and requests to end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import p2o
import pytest
from p2o import InputError
from p2o.cli import main
from p2o.files.file_names import distinct_names
from p2o.run.recipe import open_dataset

pytestmark = pytest.mark.usefixtures("plain_environment")
PLUGIN = Path(__file__).with_name("stage_plugin.py")
SPY = ["--plugin", str(PLUGIN), "--calibrator", "spy", "--perturb", "2deg 0.1m", "--witness", "none"]


def spy(data: str, *words: str) -> list[str]:
    """Return the words that run a synthetic method on synthetic frames."""
    return ["run", "--data", data, *SPY, *words]


def named(*names: str) -> str:
    """Return the words of frames with these names."""
    return f"fake:?names={json.dumps(names)}"


# ---- plugins that raise what is no error


@pytest.mark.parametrize("raised", ["SystemExit", "CancelledError", "Own"])
def test_whatever_a_method_raises_is_a_failed_result_that_names_it(
    raised: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--json", "--set", "calibrator.fail_at=1", "--set", f"calibrator.raises={raised}")
    assert main(spy("fake:?frames=3", *words)) == 1
    results = json.loads(capsys.readouterr().out)["results"]
    assert [result["status"] for result in results] == ["converged", "stage-failed", "converged"]
    assert results[1]["reason"].startswith(
        f"plugin stage_plugin.py: calibrator 'spy' raised {raised} while calibrating"
    )


@pytest.mark.parametrize(("by", "got"), [("SIGSEGV", "SIGSEGV"), ("exit", "exit status 0")])
def test_a_method_that_ends_its_process_is_a_failed_result_with_isolate(
    by: str, got: str, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ("--json", "--isolate", "--set", "calibrator.end_on=b", "--set", f"calibrator.end_by={by}")
    assert main(spy(named("a", "b", "c"), *words)) == 1
    out, error = capfd.readouterr()
    results = json.loads(out)["results"]
    assert [result["status"] for result in results] == ["converged", "stage-failed", "converged"]
    begin = f"plugin stage_plugin.py: calibrator 'spy' ended its process while calibrating; got {got}; "
    assert results[1]["reason"].startswith(begin)
    assert set(error.splitlines()) == {"a plugin that prints"}


def test_an_isolated_calibration_gives_the_same_bits(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "--data", "synthetic:?width_px=160&height_px=96&lidar=vlp-16", "--extractor", "depth/rings"]
    words += ["--init", "given", "--perturb", "1deg 0.05m", "--json"]
    poses = []
    for more in ([], ["--isolate"]):
        main([*words, *more])
        [result] = json.loads(capsys.readouterr().out)["results"]
        poses.append((result["status"], result["camera_from_lidar"], result["rounds"]))
    assert poses[0] == poses[1]
    assert len(poses[0][2]) > 1


def test_a_method_that_is_interrupted_is_interrupted(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(spy("fake:?frames=3", "--json", "--set", "calibrator.interrupt_at=1")) == 130
    assert len(json.loads(capsys.readouterr().out)["results"]) == 1


def test_an_exit_outside_of_methods_is_a_defect_and_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def leave(*_: object, **__: object) -> None:
        raise SystemExit(0)

    monkeypatch.setattr("p2o.run.run.run", leave)
    for debug in "01":
        monkeypatch.setenv("P2O_DEBUG", debug)
        assert main(spy("fake:?frames=3")) == 70
        assert capsys.readouterr().err.splitlines()[-1].startswith("p2o: error: unexpected SystemExit: 0")


# ---- bad frames among good ones


def test_a_bad_frame_is_a_row_with_its_reason_and_the_others_are_calibrated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(spy("fake:?frames=3&bad=1", "--out", str(tmp_path / "out"))) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.out.splitlines() if line.startswith(("drive/", "  predicted", "  failed"))]
    assert lines[1:4] == ["  predicted unknown", "drive/0001", "  failed    a.png: the image is cut short"]
    assert lines[4] == "drive/0002"
    assert "2 calibrations: 2 solved\n  1 frames failed" in captured.out
    assert captured.err.splitlines()[-1] == (
        "p2o: error: 1 of 3 frames could not be calibrated; got drive/0001: a.png: the image is cut short"
    )
    run = json.loads((tmp_path / "out/run.json").read_text())
    assert [row["frames"] for row in run["results"]] == [["drive/0000"], ["drive/0002"]]
    assert run["failed"] == [{"frame": "drive/0001", "reason": "a.png: the image is cut short"}]
    assert (run["summary"]["count"], run["summary"]["failed"]) == (2, 1)
    assert main(spy("fake:?frames=3&bad=1", "--json")) == 2
    assert json.loads(capsys.readouterr().out)["failed"] == run["failed"]


def test_in_python_bad_frames_are_beside_the_rows() -> None:
    registry = p2o.Registry.load(extra_files=[PLUGIN])
    run = p2o.calibrate("fake:?bad=0", calibrator="spy", witness="none", perturb="1deg", registry=registry)
    assert [row.result.frames for row in run.rows] == [("drive/0001",)]
    assert [(one.frame, one.reason) for one in run.failed] == [("drive/0000", "a.png: the image is cut short")]
    assert not run.solved
    with pytest.raises(InputError, match=r"^a\.png: the image is cut short$"):
        p2o.calibrate("fake:?bad=0", frames="0", calibrator="spy", witness="none", perturb="1deg", registry=registry)


def test_where_no_frame_can_be_calibrated_the_first_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    from p2o_testing import stage

    frame = stage.frame()
    told = [p2o.Frame(name, frame.image, frame.cloud, start=frame.camera_from_lidar) for name in "abc"]
    with pytest.raises(InputError, match=r"none of the 3 frames can be calibrated; got a: the truth is not known"):
        p2o.calibrate(told, extractor="depth/rings", perturb="1deg")


def test_a_joint_calibration_needs_every_frame_and_says_which_is_bad(refused: Callable[..., str]) -> None:
    assert refused(spy("fake:?frames=3&bad=1", "--joint")) == (
        "p2o: error: a.png: the image is cut short; "
        "a joint calibration needs every frame: leave drive/0001 out of --frames, or repair it"
    )


@pytest.mark.parametrize(
    ("output", "file"),
    [(["--export", "json:{tmp}/{{frame}}.json"], "drive_0001.json"), (["--out", "{tmp}"], "drive_0001/result.json")],
)
def test_a_disk_that_fills_up_takes_no_finished_result_away(
    output: list[str], file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Path.write_bytes

    def full(self: Path, data: Any) -> int:
        if "0001" in str(self):
            raise OSError(28, "No space left on device", str(self))
        return real(self, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    assert main(spy("fake:?frames=3", "--json", *(word.format(tmp=tmp_path) for word in output))) == 2
    captured = capsys.readouterr()
    assert [row["frames"] for row in json.loads(captured.out)["results"]] == [["drive/0000"], ["drive/0001"]]
    error = captured.err.splitlines()[-1]
    assert error.startswith(f"p2o: error: {tmp_path}/{file}: cannot write the file; got No space left")
    assert "free space" in error
    assert (tmp_path / file.replace("0001", "0000")).is_file()
    assert not (tmp_path / file).exists()


# ---- names


CLASHING = ("$x^$", "a b", "a_b", "A b", "東京", "北京", "run.json", "result.json", "convergence.png", "con", "nul.x")


def test_frames_that_would_share_a_file_have_files_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "exports").mkdir()
    export = f"json:{tmp_path}/exports/{{frame}}/pose.json"
    assert main(spy(named(*CLASHING), "--out", str(tmp_path / "out"), "--export", export)) == 0
    for files in ((tmp_path / "out").glob("*/result.json"), (tmp_path / "exports").glob("*/pose.json")):
        frames = [json.loads(path.read_text())["frames"] for path in files]
        assert sorted(frames) == sorted([name] for name in CLASHING)
    assert json.loads((tmp_path / "out/run.json").read_text())["summary"]["count"] == len(CLASHING)
    assert distinct_names(["drive/0001", "b.c"]) == {"drive/0001": "drive_0001", "b.c": "b.c"}
    names = distinct_names([*CLASHING, "x" * 300, "x" * 299 + "y", ".."], taken=("run.json",))
    assert len({name.lower() for name in names.values()}) == len(names)
    assert names["run.json"] != "run.json"
    assert {names[device].partition(".")[0].lower() for device in ("con", "nul.x")}.isdisjoint({"con", "nul"})
    assert all(len(name) < 200 and "/" not in name and name.strip(".") for name in names.values())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--export", "json:{tmp}/one.json"], "several results need several files"),
        (["--export", "json:{tmp}/{{frame}}", "--export", "kitti:{tmp}/{{frame}}"], "two outputs have the same file"),
        (["--out", "{tmp}/o", "--export", "kitti:{tmp}/o/{{frame}}/result.json"], "two outputs have the same file"),
        (["--export", "json:{tmp}/no/{{frame}}.json"], "the folder of the export is missing; create it first: mkdir -"),
        (["--export", "json:~nosuch/{{frame}}"], "the home folder of an unknown user"),
        (["--out", "~nosuch/out"], "the home folder of an unknown user"),
        (["--out", "/dev/null/out"], "cannot write the results"),
        (["--out", "{tmp}/" + 300 * "x"], "File name too long"),
    ],
)
def test_outputs_that_cannot_be_written_are_told_before_any_work(
    words: list[str], message: str, tmp_path: Path, refused: Callable[..., str]
) -> None:
    assert message in refused(spy("fake:", *(word.format(tmp=tmp_path) for word in words)))


HOSTILE = "a\x1b[31m\x9b2J\u202egnp\x7f"


def test_no_name_moves_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(spy(named(HOSTILE, "b"))) == 0
    assert main(["run", "--data", named(HOSTILE), *SPY, "--frames", f"{HOSTILE}x"]) == 2
    assert main(["data", "list", named(HOSTILE), "--plugin", str(PLUGIN)]) == 0
    captured = capsys.readouterr()
    for text in (captured.out, captured.err):
        assert r"a\x1b[31m\x9b2J\u202egnp\x7f" in text
        assert not [c for c in text if c != "\n" and unicodedata.category(c) in ("Cc", "Cf")]


def test_words_that_are_not_utf_8_are_told_before_any_work(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "p2o", "run", "--data", b"folder:" + os.fsencode(tmp_path) + b"/\xff"]
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode == 2
    assert done.stdout == b""
    assert done.stderr.startswith(b"p2o: error: the command contains bytes that are not UTF-8; got folder:")
    assert rb"\udcff" in done.stderr


def test_frames_whose_names_are_no_text_are_told_before_any_work() -> None:
    class Dataset(list[p2o.Frame]):
        names = ("good", "bad\udcff")

    @p2o.hookimpl
    def p2o_datasets() -> Any:
        yield p2o.Method(name="bytes", build=lambda _: Dataset([None, None]), summary="Bad names.")

    plugin = type("plugin", (), {"p2o_datasets": staticmethod(p2o_datasets)})
    with pytest.raises(InputError, match=r"the name of a frame is not UTF-8; got bad\\udcff"):
        open_dataset("bytes:", p2o.Registry.of(plugin))


# ---- ends


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT], ids=lambda number: number.name)
def test_a_request_to_end_keeps_what_is_finished(number: signal.Signals, tmp_path: Path) -> None:
    words = spy("fake:", "--set", "calibrator.hang_at=1", "--out", str(tmp_path))
    # Commands in the background of a script ignore SIGINT; SIGTERM has to end them as well.
    ignored = number is signal.SIGTERM
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if ignored else signal.getsignal(signal.SIGINT)
    try:
        process = subprocess.Popen(
            [sys.executable, "-u", "-m", "p2o", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("hanging"):
            break
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err.splitlines()[-1] == "p2o: interrupted; 1 finished calibrations are kept"
    run = json.loads((tmp_path / "run.json").read_text())
    assert run["summary"]["interrupted"] is True
    assert [row["frames"] for row in run["results"]] == [["drive/0000"]]
    assert "Traceback" not in out + err


def test_who_calls_the_command_line_keeps_the_handlers_of_signals() -> None:
    def mine(*_: object) -> None:
        raise AssertionError

    before = signal.signal(signal.SIGTERM, mine)
    try:
        assert main(["--version"]) == 0
        assert signal.getsignal(signal.SIGTERM) is mine
    finally:
        signal.signal(signal.SIGTERM, before)
    assert main(["--version"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before


def test_warnings_of_python_stay_off_stderr() -> None:
    command = [sys.executable, "-m", "p2o", *spy("fake:?frames=1", "--set", "calibrator.warn=true")]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONWARNINGS"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment | {"P2O_DEBUG": "1"})
    assert re.search("RuntimeWarning: a\nwarning of Python", done.stderr)


def test_the_accuracy_of_the_initial_guess_is_an_input_that_results_state(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "--data", "synthetic:?scenes=1&right=false&seed=3&width_px=621&height_px=188"]
    words += ["--extractor", "depth/rings", "--perturb", "2deg 0.15m"]
    assert main([*words, "--start-sigma", "2deg 0.1m", "--json"]) == 0
    [result] = json.loads(capsys.readouterr().out)["results"]
    assert result["recipe"]["options"]["pipeline"]["start_sigma"] == [2.0, 0.1]
    assert result["start_weight"]["sigma_deg"] == 2.0
    assert main([*words, "--start-sigma", "2deg"]) == 2
    assert "--start-sigma" in capsys.readouterr().err
