"""The command line: what it prints where, and with which exit status."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import p2o
import pytest
import yaml
from p2o import Result, Status
from p2o.cli import _COMMANDS, main
from p2o.cli.run import Required
from p2o.cli.summary import describe, describe_briefly, describe_run
from p2o.results.verdict import Doubt, Reason, Verdict
from p2o.run.outcome import Row, Run
from p2o.solving import Accuracy

from tests.p2o_datasets.kitti_files import HEIGHT, WIDTH, write_image

pytestmark = pytest.mark.usefixtures("plain_environment")
PLUGIN = Path(__file__).with_name("stage_plugin.py")
STAGE = ["--plugin", str(PLUGIN), "--data", "fake:?frames=1"]
# Quick and sure: the oracle of the image side on the stage of the conformance checks.
QUICK = [*STAGE, "--extractor", "depth/rings", "--init", "given"]
TOLERANT = [*QUICK, "--set", "pipeline.most_deg=2"]
"""The small image of one frame determines rotations to about 1 deg (95 %)."""


@pytest.fixture
def fake() -> list[str]:
    """Words that run a synthetic method on synthetic frames."""
    return ["run", "--plugin", str(PLUGIN), "--data", "fake:", "--calibrator", "spy", "--perturb", "2deg 0.1m"]


def in_a_shell(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "p2o", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})


# ---- what it costs to ask


HEAVY = ("torch", "cv2", "kornia", "pycolmap", "pyceres", "scipy", "numpy", "matplotlib", "pydantic", "pluggy")


def test_help_imports_nothing_heavy() -> None:
    code = "import sys; from p2o.cli import main; main(['--help']); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Commands:" in done.stdout
    assert not {name.partition(".")[0] for name in done.stderr.split()} & set(HEAVY)


def test_listing_imports_no_package_that_methods_need() -> None:
    commands = [["methods"], ["plugin", "list"], ["methods", "ogm"], ["data", "list", "synthetic:"]]
    code = "import sys; from p2o.cli import main; "
    code += f"print([main(words) for words in {commands}]); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[0, 0, 0, 0]"
    loaded = {name.partition(".")[0] for name in done.stderr.split()}
    assert "p2o_plugins" in loaded
    assert not loaded & {"torch", "cv2", "kornia", "pycolmap", "pyceres", "matplotlib"}
    assert "scipy.optimize" not in done.stderr.split()


def test_a_thread_of_a_plugin_that_raises_gives_one_line() -> None:
    code = "import sys, threading; from p2o.cli import main; main(); thread = threading.Thread(target=lambda: 1 / 0); "
    words = [sys.executable, "-c", code + "thread.start(); thread.join()", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert (
        done.stderr
        == "p2o: warning: a thread ended with ZeroDivisionError: division by zero; P2O_DEBUG=1 shows where\n"
    )


def test_a_run_imports_no_reports_and_no_package_that_it_does_not_need() -> None:
    """On the processor because it is asked to, and because there is no driver of a GPU."""
    run = ["run", "--data", "synthetic:?megapixels=0.1", "--perturb", "1deg 0.05m"]
    code = "import sys, p2o.runtime.native; from p2o.cli import main; "
    code += f"print(main({[*run, '--set', 'image.device=cpu']})); p2o.runtime.native.has_gpu_driver = lambda: False; "
    code += f"print(main({run})); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stderr.split()
    assert "p2o.run.run" in loaded
    assert not {"p2o_study.report", "p2o_study", "scipy.optimize"} & set(loaded)
    packages = {name.partition(".")[0] for name in loaded}
    assert not packages & {"torch", "kornia", "pycolmap", "pyceres", "matplotlib", "joblib"}
    listed = [name for name in loaded if name.partition(".")[0] in ("p2o_baselines", "p2o_datasets", "p2o_formats")]
    assert {name.partition(".")[2] for name in listed} <= {"", "hooks", "commands"}, "what a run does not use is listed"


NO_EXTRAS = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "kornia", "pycolmap", "matplotlib", "onnx", "lazy_loader"):
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
sys.meta_path.insert(0, Missing())
from p2o.cli import main
print([main(line.split(";")) for line in sys.argv[1:]])
"""
"""A program in which no package of an extra is installed that some methods or reports import."""
SMALL = "synthetic:?megapixels=0.1"
WITHOUT_EXTRAS = {
    f"run;--data;{SMALL};--perturb;1deg 0.05m": "",
    f"run;--data;{SMALL};--set;extractor.device=cuda": "p2ornet' needs the package torch",
    f"run;--data;{SMALL};--calibrator;lccnet": "lccnet' needs the package torch",
    f"train;p2ornet;--data;{SMALL};--out;out": "needs the package torch",
    "run;--out;out": "",
    f"check;{SMALL};--extrinsic;truth;--frames;0": "",
    "run;synthetic:?camera=opencv-distorted&megapixels=0.1": "",
    "doctor;--quick": "",
    "methods;--matrix": "",
}
"""Commands, and what is said of those that need an extra."""


def test_without_extras_all_but_what_needs_them_works(tmp_path: Path) -> None:
    command = [sys.executable, "-c", NO_EXTRAS, *WITHOUT_EXTRAS]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert "Traceback" not in done.stderr
    statuses = json.loads(done.stdout.splitlines()[-1])
    assert [status == 0 for status in statuses] == [not said for said in WITHOUT_EXTRAS.values()], done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("p2o: error")]
    for error, said in zip(errors, filter(None, WITHOUT_EXTRAS.values()), strict=True):
        assert said in error
        assert "pip install" in error


@pytest.mark.parametrize("command", ["", *_COMMANDS, "data list", "data check", "plugin list", "plugin check"])
def test_every_command_explains_itself(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*command.split(), "--help"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"Usage: p2o {command}".rstrip())
    assert "\\" not in out, "marks of the source do not reach the reader"
    assert not [c for c in out if c != "\n" and not c.isprintable()]


def test_the_examples_in_the_help_keep_their_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--help"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert 'p2o run folder:PATH --start roughly "x forward, z up; camera looks 45 deg left"' in lines
    assert main(["simulate", "--help"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert "p2o simulate out --layout kitti-raw --set scenes=20 --seed 1" in lines


# ---- p2o run


def test_without_data_the_built_in_frame_is_calibrated(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--perturb", "1deg 0.05m", "--verbose"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("street\n  status ")
    for label in ("initial", "result", "moved", "error", "seconds"):
        assert f"  {label} " in out
    before, after = (
        re.search(rf"^    {word} +([\d.]+) +([\d.]+) ", out, re.MULTILINE) for word in ("initial", "result")
    )
    assert before.groups() == ("1.000", "0.050")
    assert float(after[1]) < 0.2, "degrees: the search and the edges do their work"
    assert float(after[2]) < 0.05


FIELDS = {
    *("camera_from_lidar", "start", "status", "reason", "error", "start_error"),
    *("frames", "rounds", "seconds", "recipe", "seed", "versions"),
}


def test_json_is_one_object_for_each_frame_and_a_summary(fake: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*fake, "--json", "--seed", "3"]) == 0
    captured = capsys.readouterr()
    run = json.loads(captured.out)
    assert captured.out.count("\n") == 1
    assert "a plugin that prints" in captured.err
    assert set(run) == {"results", "failed", "summary"}
    assert [row["frames"] for row in run["results"]] == [["drive/0000"], ["drive/0001"]]
    for row in run["results"]:
        assert set(row) >= FIELDS
        assert np.shape(row["camera_from_lidar"]) == np.shape(row["start"]) == (4, 4)
        assert set(row["error"]) == {"rotation_deg", "translation_m", "per_axis"}
        assert row["start_error"]["rotation_deg"] == pytest.approx(2.0)
        assert row["seed"] == 3
    assert run["summary"]["status"] == {"converged": 2}
    assert run["summary"]["trust"] == Counter(row["verdict"]["trust"] for row in run["results"])
    assert run["summary"]["error"]["rotation_deg_mean"] == pytest.approx(2.0)


def test_errors_are_null_where_the_truth_is_not_known() -> None:
    from p2o_testing import stage

    frame = stage.frame()
    told = p2o.Frame("a", frame.image, frame.cloud, start=frame.camera_from_lidar)
    row = p2o.calibrate(told, extractor="depth/rings", init="given").rows[0].as_dict()
    assert row["error"] is None
    assert row["start_error"] is None


def test_a_recipe_from_json_repeats_the_run_to_the_last_bit(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *QUICK, "--perturb", "0.5deg 0.02m", "--seed", "2", "--json"]) == 0
    [row] = json.loads(capsys.readouterr().out)["results"]
    run = p2o.calibrate(**row["recipe"], registry=p2o.Registry.load(extra_files=[PLUGIN]))
    assert run.result.camera_from_lidar.tolist() == row["camera_from_lidar"]
    assert run.rows[0].as_dict()["recipe"] == row["recipe"]


def test_the_likely_accuracy_is_said_and_may_be_required(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", *TOLERANT, "--perturb", "0.5deg 0.02m"]
    assert main([*words, "--json", "--require", "trusted 2deg 50cm"]) == 0
    captured = capsys.readouterr()
    [row] = json.loads(captured.out)["results"]
    accuracy = row["accuracy"]
    assert captured.err == ""
    assert 0.02 <= accuracy["rotation_deg"] < accuracy["rotation_deg_95"]
    assert 0.02 <= accuracy["translation_m"] < accuracy["translation_m_95"]
    assert main([*words, "--require", "2deg 1mm"]) == 1
    captured = capsys.readouterr()
    assert "  predicted rotation error " in captured.out
    assert captured.err == "p2o: the result does not reach 2deg 0.001m, as --require asks\n"


def test_results_without_trust_or_accuracy_and_refused_ones_do_not_meet_a_requirement(
    fake: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(fake) == 0
    assert main([*fake, "--require", "90deg 9m"]) == 1
    assert "2 of 2 results are not trusted" in capsys.readouterr().err
    untold = judged(accuracy=None).result
    assert Required.of("90deg 9m").unmet([untold] * 2) == ["2 of 2 results do not reach 90deg 9m"]
    refused = [*fake, "--set", "calibrator.status=too-few-matches"]
    assert main([*refused, "--require", "trusted"]) == 1
    assert capsys.readouterr().err.endswith("p2o: 2 of 2 results are not trusted, as --require asks\n")
    assert main(refused) == 1
    out = capsys.readouterr().out
    assert out.count("  verdict   refused\n") == out.count("too-few-matches: because it is a test") == 2
    assert "2 calibrations: 2 too-few-matches" in out


def judged(*doubts: Doubt, **values: Any) -> Row:
    """Return a row whose result has these doubts."""
    verdict = Verdict(tuple(Reason(doubt, f"{doubt} is said") for doubt in doubts))
    status = Status.NO_EDGES if Doubt.NOT_SOLVED in doubts else Status.CONVERGED
    result = Result(("a",), np.eye(4), np.eye(4), status, "because", **{"verdict": verdict, **values})
    return Row(result, None, None, None)


def test_the_verdict_is_a_line_with_its_reasons() -> None:
    def lines(row: Row) -> list[str]:
        return [line for line in describe(row).splitlines() if line.startswith("  verdict")]

    assert lines(judged()) == ["  verdict   trusted"]
    assert lines(judged(Doubt.CAMERA)) == ["  verdict   doubtful: camera is said"]
    both = judged(Doubt.RIVAL_POSE, Doubt.LITTLE_AGREEMENT)
    assert lines(both) == ["  verdict   doubtful: rival-pose is said; little-agreement is said"]
    assert lines(judged(verdict=Verdict((Reason(Doubt.NOT_SOLVED, "because"),)))) == ["  verdict   refused"], (
        "the status has said why"
    )


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("doubts", [(), (Doubt.NOT_SOLVED,), (Doubt.CAMERA,), (Doubt.RIVAL_POSE, Doubt.TOO_UNSURE)])
def test_at_most_eight_lines_are_printed_about_a_result(doubts: tuple[Doubt, ...], known: bool) -> None:
    row = judged(*doubts, warnings=("a: one", "two"), licences={"extractor": "research only"})
    error = p2o.pose_error(np.eye(4), np.eye(4)) if known else None
    row = Row(row.result, None, error, error)
    lines = describe_briefly(row).splitlines()
    labels = [line[2:12].strip() for line in lines[1:] if line[2] != " "]
    assert len(lines) <= 8
    assert lines[0] == "a"
    assert labels[0] == ("status" if Doubt.NOT_SOLVED in doubts else "verdict")
    assert "warning" in labels
    assert "next" not in labels or doubts
    assert ("next" in labels) == (Doubt.NOT_SOLVED in doubts), "remarks come first"
    assert all(f"{doubt} is said" in describe_briefly(row) for doubt in doubts)
    assert len(describe(row).splitlines()) > len(lines)


def test_solved_results_of_a_run_are_counted_by_their_verdict() -> None:
    rows = (judged(), judged(), judged(Doubt.RIVAL_POSE), judged(Doubt.CAMERA), judged())
    run = Run((*rows, judged(Doubt.NOT_SOLVED)))
    lines = describe_run(run).splitlines()
    assert lines[:2] == ["6 calibrations: 1 no-edges, 5 solved", "  5 solved: 3 trusted, 1 ambiguous, 1 doubtful"]
    assert run.summary["trust"] == {"trusted": 3, "ambiguous": 1, "doubtful": 1, "refused": 1}
    assert describe_run(Run((judged(Doubt.NOT_SOLVED),))) == "1 calibrations: 1 no-edges"


@pytest.mark.parametrize(
    ("text", "doubts", "missed"),
    [
        ("trusted", (), []),
        ("trusted", (Doubt.CAMERA,), ["the result is not trusted"]),
        ("trusted", (Doubt.RIVAL_POSE,), ["the result is not trusted"]),
        ("trusted 0.3deg 0.1m", (), []),
        ("trusted 0.3deg 0.1m", (Doubt.NOT_CHECKED,), ["the result is not trusted"]),
        ("0.3deg 0.1m", (Doubt.NOT_CHECKED,), ["the result is not trusted"]),
        ("0.1deg 0.1m", (), ["the result does not reach 0.1deg 0.1m"]),
    ],
)
def test_what_is_required_is_trust_and_a_size(text: str, doubts: tuple[Doubt, ...], missed: list[str]) -> None:
    result = judged(*doubts, accuracy=Accuracy(0.2, 0.05, 0.6, 0.2)).result
    assert Required.of(text).unmet([result]) == missed


PICTURES = [
    *("after.png", "before.png", "cloud.ply"),
    *(f"sweep-{by}-{name}.png" for by in ("range", "reflectance") for name in ("after", "before")),
]


def test_a_run_prints_eight_lines_or_all_evidence_and_writes_result_and_overlays_of_every_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "out"
    words = ["run", *QUICK, "--perturb", "0.5deg 0.02m"]
    assert main([*words, "--out", str(out)]) == 0
    assert len(capsys.readouterr().out.splitlines()) <= 8
    home = out / "drive_0000"
    assert sorted(path.name for path in home.iterdir()) == sorted([*PICTURES, "result.json"])
    images = {name: cv2.imread(str(home / name)) for name in PICTURES if name.endswith(".png")}
    assert {image.shape for image in images.values()} == {(240, 480, 3)}
    for kind in ("", "sweep-range-"):
        assert not np.array_equal(images[f"{kind}before.png"], images[f"{kind}after.png"])
    result = json.loads((home / "result.json").read_text())
    assert result == json.loads((out / "run.json").read_text())["results"][0]
    assert main([*words, "-v"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 16
    [matches] = [line for line in lines if line.startswith("  matches")]
    total, _, parts = matches.removeprefix("  matches").strip().partition(": ")
    assert int(total) == sum(int(part.split()[1]) for part in parts.split(", "))
    assert {part.split()[0] for part in parts.split(", ")} <= set("LRUB")
    [residual] = [line for line in lines if line.startswith("  residual")]
    assert residual.count(" px") == parts.count(",") + 1


def test_the_motion_that_the_edges_tell_is_said_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "--data", "synthetic:?deskew=false&speed_m_s=16&right=false", "--extractor", "depth/rings"]
    words += ["--init", "given", "--perturb", "0.5deg 0.02m", "-v"]
    assert main([*words, "--out", str(tmp_path / "found")]) == 0
    assert re.search(r"motion    \d+\.\d m/s \(sigma \d+\.\d\) forward, .* deg/s", capsys.readouterr().out)
    assert main([*words, "--set", "pipeline.motion=trust", "--out", str(tmp_path / "trusted")]) == 0
    assert "  motion " not in capsys.readouterr().out
    found, trusted = (
        json.loads((tmp_path / name / "run.json").read_text())["results"][0] for name in ("found", "trusted")
    )
    assert found["motions"][0]["speed_m_s"] == pytest.approx(16, abs=4)
    assert trusted["motions"] == []
    assert found["error"]["translation_m"] < 0.5 * trusted["error"]["translation_m"]


def test_a_joint_result_is_of_the_same_schema_and_lies_in_the_folder_itself(
    fake: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*fake, "--json", "--joint", "--out", str(tmp_path)]) == 0
    run = json.loads(capsys.readouterr().out)
    assert set(run) == {"results", "failed", "summary"}
    assert run == json.loads((tmp_path / "run.json").read_text())
    [result] = run["results"]
    assert set(result) >= FIELDS
    assert result == json.loads((tmp_path / "result.json").read_text())
    assert result["frames"] == ["drive/0000", "drive/0001"]
    assert (run["summary"]["count"], result["recipe"]["joint"]) == (1, True)
    files = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file())
    of_frames = [f"drive_000{number}/{name}" for number in (0, 1) for name in PICTURES]
    assert files == sorted([*of_frames, "result.html", "result.json", "run.json"])


# ---- errors

DIGITS = 5000 * "9"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "--matcher", "ogmm"], "unknown matcher 'ogmm'; expected one of: crlf, gmm,"),
        (["run", "--extractor", "canny/rings"], "canny gives no side; ogm needs it; try --matcher knn-line or nearest"),
        (["run", "--set", "matcher.neighbours=0"], "matcher.neighbours is out of bounds; expected greater"),
        (["run", "--perturb", "2 degrees"], "--perturb: cannot read the size"),
        (["run", "--require", "trusted 0.3deg"], '--require: the accuracy needs two parts; expected "trusted", or'),
        (["run", "--start-sigma", "2 apples"], "--start-sigma: cannot read the size; expected an angle and a length"),
        (["run", "--perturb", "1deg 101m"], "--perturb: the size is out of bounds; expected 0..180 deg and 0..100 m"),
        (["run", "--require", "1deg 1e300m"], "--require: the size is out of bounds"),
        (["run", "--perturb", "1deg nanm"], "--perturb: cannot read the size"),
        (["run", "--set", "solver.tolerance=nan"], "solver.tolerance is not valid; expected a finite number; got nan"),
        (["run", "--set", f"matcher.huber_px=[{DIGITS}]"], "the value is not YAML; got Exceeds the limit (4300"),
        (["run", "synthetic:", "--set", "data.scenes=[2020-01-01]"], "data.scenes is not valid; expected a valid"),
        (["run", "synthetic:", "--set", "data.scenes=" + 3000 * "["], "the value is nested too deeply; expected at"),
        (["run", "--set", "solver.tolerance=1", "--set", "solver.tolerance.y=2"], "solver.tolerance is set already"),
        (["run", "--seed", str(2**63)], "recipe.seed is out of bounds; expected less than or equal to"),
        (["run", "--frames", f"0:{DIGITS}"], "--frames: unknown frame '0:999"),
        (["run", "--frames", "0-999999999"], "--frames: frame index 999999999 is out of range; expected 0 to 0"),
        (["run", "--frames", "@/dev/zero"], "/dev/zero: the file of splits is a device"),
        (["run", "--data", "synthetic:?seed=1&seed=2"], "the option seed is said twice"),
        (["run", "--data", "synthetic:?seed=%00"], r"data.seed is not valid; expected a valid integer"),
        (["run", "--data", "folder:/a\x1b[31m"], r"/a\x1b[31m: no such folder"),
        (["run", "--data", "folder:~nosuch/x"], "~nosuch/x: the home folder of an unknown user"),
        (["run", "--plugin", "~nosuch/x.py"], "~nosuch/x.py: the home folder of an unknown user"),
        (["run", "--plugin", 300 * "x" + ".py"], "File name too long"),
        (["run", "--out", ""], "--out: the folder has no name"),
        (["run", "--matcher", 100000 * "x"], "unknown matcher 'xxx"),
        (["train", "p2ornet", "--data", "synthetic:", "--out", "a", "--share", "nan"], "--share: the share is not"),
        (["simulate", "~nosuch/x", "--layout", "folder"], "~nosuch/x: the home folder of an unknown user"),
        (["simulate", "x", "--layout", "folder", "--set", "a.x=1", "--set", "a=2"], "--set: a.x is set already"),
        (["plugin", "check", "a/b.py"], "load a file with --plugin: p2o plugin check b --plugin a/b.py"),
        (["run", "--frames", "@absent.json#test"], "absent.json: the file of splits is missing"),
        (["run", "--data", "kitti-raw:/no/such/folder"], "/no/such/folder"),
        (["run", "--data", "/no/such/folder"], "/no/such/folder: no such file or folder; expected DATASET:PATH"),
        (["run", "a:", "--data", "b:"], "the data are given twice, as DATA and as --data"),
        (["check", "--extrinsic", "truth"], "Missing argument '[DATASET:]PATH'"),
        (["run", "--matcher", "koo"], "koo is a method of another kind, calibrator: --calibrator koo"),
        (["run", "--extractor", "rings/rings"], "another kind, cloud extractor: --extractor IMAGE/rings"),
        (["run", "--method", "nidd"], "unknown method 'nidd'"),
        (["run", "--matcher", "mi"], "--method mi, which stands for --extractor grey/reflectance --matcher mi"),
        (["run", "--seed", "-1"], "Invalid value for '--seed'"),
        (["run", "--block", "p2o-calibb"], "unknown plugin to block 'p2o-calibb'"),
        (["run", "--plugin", "absent.py"], "absent.py: no such plugin file"),
        (["run", "--zzzqq"], "No such option '--zzzqq'; see p2o run --help"),
        (["rum"], "No such command 'rum'"),
        (["plugin", "check", "p2o-cali"], "unknown plugin or method 'p2o-cali'"),
    ],
)
def test_wrong_usage_and_input_are_one_line_on_stderr_and_status_2(
    words: list[str], message: str, refused: Callable[..., str]
) -> None:
    line = refused(words)
    assert message in line
    assert line.count("did you mean") <= 1
    assert len(line) < 5000


def test_a_defect_is_one_line_too_with_a_hint(
    fake: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import p2o.run.run as home

    def crash(*_: Any) -> None:
        raise RuntimeError("the sky\nis falling")

    monkeypatch.setattr(home, "pose_error", crash)
    assert main(fake) == 70
    error = capsys.readouterr().err.splitlines()[-1]
    assert error == (
        "p2o: error: unexpected RuntimeError: the sky is falling; set P2O_DEBUG=1 for a traceback, and report it"
    )
    monkeypatch.setenv("P2O_DEBUG", "1")
    with pytest.raises(RuntimeError, match="the sky"):
        main(fake)


def test_stderr_is_silent_where_it_is_no_terminal() -> None:
    done = in_a_shell("run", *QUICK, "--perturb", "0.5deg 0.02m", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert len(json.loads(done.stdout)["results"]) == 1


def test_a_closed_pipe_is_no_error() -> None:
    for words, line in (
        ("data list 'synthetic:?scenes=8000'", "scene-"),
        ("doctor --quick --json", "{"),
    ):
        command = f"{sys.executable} -m p2o {words} | head -c 10"
        done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
        assert done.stdout.startswith(line)
        assert done.stderr == ""


# ---- the other commands


def test_methods_lists_every_method_by_kind_with_its_summary(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["methods"]) == 0
    out = capsys.readouterr().out
    for offer in p2o.Registry.load().offers:
        assert f"{offer.kind}s\n" in out
        assert f"  {offer.name}" in out
        assert offer.method.summary in out


@pytest.mark.parametrize(
    ("name", "stage", "texts"),
    [
        ("ogm", "matcher", ["matcher ogm", "needs    cloud-edges, image-edges, side", "int >= 2"]),
        ("synthetic", "data", ["float >= 0, <= 60", "strongest | first", "3 x float >= -100, <= 100, 3 x float"]),
        ("pipeline", "pipeline", ["pipeline summary"]),
    ],
)
def test_methods_explains_every_option_in_words_and_lines_as_wide_as_a_terminal(
    name: str, stage: str, texts: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    from p2o.calibration.options import PipelineOptions

    assert main(["methods", name]) == 0
    out = capsys.readouterr().out
    options = PipelineOptions if name == stage else p2o.Registry.load().named(name)[0].method.options
    said = " ".join(out.split())
    for field_name, field in options.model_fields.items():
        assert re.search(rf"^    {field_name} ", out, re.MULTILINE)
        assert field.description in said
    assert all(" ".join(text.split()) in said for text in [*texts, f"--set {stage}.NAME=VALUE"])
    assert "Annotated" not in out
    assert max(map(len, out.splitlines())) <= 120


def test_the_matrix_says_what_fits(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["methods", "--matrix"]) == 0
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines() if line}
    heads = rows["extractor"][2:]  # after "\ matcher"
    fits = {pair: dict(zip(heads, rows[pair], strict=True)) for pair in ("canny/rings", "stereo/rings")}
    assert [fits["canny/rings"][matcher] for matcher in ("nearest", "ogm")] == ["yes", "-"]
    assert [fits["stereo/rings"][matcher] for matcher in ("nearest", "ogm")] == ["yes", "yes"]


def test_plugins_are_json_with_the_broken_ones_and_those_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    info = tmp_path / "bad_one-0.9.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bad-one\nVersion: 0.9\n")
    (info / "entry_points.txt").write_text("[p2o]\nhooks = no_such_module_at_all\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert main(["plugin", "list", "--block", "p2o-calib:baselines"]) == 0
    captured = capsys.readouterr()
    shown = json.loads(captured.out)
    [ours] = [plugin for plugin in shown["plugins"] if plugin["name"] == "p2o-calib:plugins"]
    assert {"kind": "matcher", "name": "ogm"} in ours["methods"]
    assert ours["version"]
    [broken] = shown["broken"]
    assert (broken["name"], broken["version"]) == ("bad-one:hooks", "0.9")
    assert "no_such_module_at_all" in broken["error"]
    assert shown["left_out"] == ["p2o-calib:baselines"]
    assert captured.err.count("\n") == 1
    # The tool goes on without it, and says so where a name is missing.
    assert main(["run", "--matcher", "theirs"]) == 2
    assert "plugin bad-one:hooks is broken" in capsys.readouterr().err
    monkeypatch.setenv("P2O_STRICT", "1")
    assert main(["plugin", "list"]) == 2


def test_check_plugin_says_what_is_promised_and_broken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plugin", "check", "lm"]) == 0
    out = capsys.readouterr().out
    assert "ok    solver lm: solver_returns_to_the_truth" in out
    assert out.endswith("every check passed\n")
    file = tmp_path / "lazy.py"
    file.write_text(
        "import p2o\n@p2o.hookimpl\ndef p2o_solvers():\n"
        "    yield p2o.Method(name='lazy', build=lambda o: lambda problem, pose: p2o.Solution(pose, 0.0, 1),\n"
        "        summary='Stays.', needs={'pairs'},\n"
        "        expected_failures=(('solver_returns_to_the_truth', 'it is lazy'),))\n"
    )
    assert main(["plugin", "check", "lazy", "--plugin", str(file)]) == 1
    out = capsys.readouterr().out
    assert "known solver lazy: solver_returns_to_the_truth (it is lazy)" in out
    assert "FAIL  solver lazy: solver_says_when_nothing_is_determined\n      promised: Without any pairs" in out
    assert out.endswith("2 checks failed\n")


def test_check_plugin_tells_what_it_could_not_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lonely.py"
    file.write_text(
        "import p2o\n@p2o.hookimpl\ndef p2o_matchers():\n"
        "    yield p2o.Method(name='lonely', build=lambda o: lambda *given: None, summary='Wants lines.',\n"
        "        needs={'image-circles'}, gives={'pairs'})\n"
    )
    assert main(["plugin", "check", "lonely", "--plugin", str(file)]) == 0
    out = capsys.readouterr().out
    said = "n/a   matcher lonely: matches_repeat\n      not applicable: no installed extractor gives image-circles\n"
    assert said in out
    assert "ok    matcher lonely: builds_twice_offline\n" in out
    assert out.endswith(f"every check passed, {out.count('n/a ')} not applicable\n")


def test_data_list_and_check_name_every_frame(fake: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    plugin = fake[1:3]
    assert main(["data", "list", "fake:?frames=3", *plugin, "--frames", "1-2"]) == 0
    assert capsys.readouterr().out == "drive/0001\ndrive/0002\n"
    assert main(["data", "check", "fake:?bad=0", *plugin]) == 2
    bad, good, summary = capsys.readouterr().out.splitlines()
    assert bad == "drive/0000: BAD: a.png: the image is cut short"
    assert good.startswith(
        "drive/0001: 480x240 px PINHOLE, 96000 points, 64 rings, 100 % of returns with a neighbour within 0.6 deg, "
        "column, intensity, time_s, right, depth"
    )
    assert summary == "1 of 2 frames are good"


def test_data_check_names_fields_that_are_not_used_and_the_unit_of_points(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "image.png")
    camera = {"model": "PINHOLE", "width": WIDTH, "height": HEIGHT, "params": [50.0, 50.0, 31.0, 15.5]}
    (tmp_path / "frame.yaml").write_text(yaml.safe_dump({"camera": camera, "cloud_scale": 1.0}))
    xyz = np.random.default_rng(0).uniform(-3000, 3000, (900, 3))
    np.savez(tmp_path / "cloud.npz", xyz=xyz, laser_id=np.arange(900) % 16, line=np.arange(900), rgb=np.zeros(900))
    assert main(["data", "check", f"folder:{tmp_path}"]) == 0
    first, unused, warning, _ = capsys.readouterr().out.splitlines()
    assert "900 points, 16 rings, " in first
    assert unused == "  fields of the points not used: line, rgb"
    assert "which no scene has: they are probably in millimetres" in warning
    (tmp_path / "frame.yaml").write_text(yaml.safe_dump({"camera": camera, "cloud_scale": 0.001}))
    assert main(["data", "check", f"folder:{tmp_path}"]) == 0
    assert "which no scene has" not in capsys.readouterr().out


def test_data_check_names_what_the_dataset_leaves_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    (tmp_path / "a/frame.yaml").write_text("camera: 5\n")
    assert main(["data", "check", f"folder:{tmp_path}"]) == 2
    bad, left_out, summary = capsys.readouterr().out.splitlines()
    assert bad.startswith("a: BAD: ")
    assert "got camera: 5" in bad
    assert left_out == f"b: left out: {tmp_path / 'b/frame.yaml'} is missing"
    assert summary == "0 of 1 frames are good"
