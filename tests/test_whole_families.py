"""Whole methods of three families stand as plugins on the public names alone: hand-eye, checkerboards, a network."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
import threadpoolctl
from p2o import Kind, Registry, Status, se3
from p2o.cache import FeatureCache
from p2o.calibration.options import PipelineOptions
from p2o.cli import main
from p2o.geometry.perturb import parse_perturbation
from p2o.host.guard import GuardedCalibrator
from p2o.run.recipe import open_dataset
from p2o.run.words import split_data
from p2o_study import worker
from p2o_study.ablate import Ablation, ablate
from p2o_study.parallel import Workers
from p2o_study.rows import Rows
from p2o_study.study import StudyFile, parse_study
from p2o_study.worker import Plugins
from p2o_testing import checks_for, stage

from tests.test_architecture import HEAVY, Source, private_names

FOLDER = Path(__file__).with_name("family_plugins")
FAMILIES = {"hand-eye-poses": "hand_eye", "checkerboard": "checkerboard", "regressor": "regressor"}


@dataclass(frozen=True)
class Family:
    """A plugin and the frames on which it promises to succeed, written to disk once."""

    name: str
    frames: Path

    @property
    def plugin(self) -> Path:
        return FOLDER / f"{FAMILIES[self.name]}.py"

    @property
    def method(self) -> p2o.Method:
        return offer_of(self.name).method

    @property
    def example(self) -> p2o.Example:
        example = self.method.example
        assert example is not None
        return example

    def run(self, capsys: pytest.CaptureFixture[str], *words: str, perturb: str = "") -> dict[str, Any]:
        """Return the one result that `p2o run --json` prints of the method's own example."""
        command = ["run", "--plugin", str(self.plugin), "--calibrator", self.name, "--data", f"folder:{self.frames}"]
        command += ["--perturb", perturb or self.example.perturb, "--json", *["--joint"] * self.example.joint]
        code = main([*command, *words])
        out, err = capsys.readouterr()
        assert code in (0, 1), err
        [result] = json.loads(out)["results"]
        return dict(result)

    def solve(self, frames: str = "all", **words: Any) -> p2o.Result:
        """Return the joint result of the method in Python, checked by nothing."""
        registry = Registry.load(extra_files=[self.plugin])
        words = {"perturb": self.example.perturb, "witness": "none", "joint": True, **words}
        return p2o.calibrate(
            f"folder:{self.frames}", frames=frames, calibrator=self.name, registry=registry, **words
        ).result


def offer_of(name: str) -> Any:
    return Registry.load(extra_files=[FOLDER / f"{FAMILIES[name]}.py"]).find(Kind.CALIBRATOR, name)


@pytest.fixture(autouse=True)
def _no_others(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv("P2O_PLUGINS", raising=False)
    # What another test has left in this process would hide that something is prepared.
    worker._features.values.clear()
    worker._frames.values.clear()
    with threadpoolctl.threadpool_limits(1):
        yield


@pytest.fixture(scope="session")
def of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Family]:
    """Return the maker of families: the frames of their examples are simulated once."""
    made: dict[str, Family] = {}

    def make(name: str) -> Family:
        if name not in made:
            root = tmp_path_factory.mktemp("frames") / name
            data, options = split_data(offer_of(name).method.example.data)
            assert data == "synthetic"
            words = [word for field, value in options.items() for word in ("--set", f"{field}={value}")]
            with redirect_stdout(io.StringIO()):
                assert main(["simulate", str(root), "--layout", "folder", *words]) == 0
            made[name] = Family(name, root)
        return made[name]

    return make


@pytest.fixture(params=FAMILIES)
def family(request: pytest.FixtureRequest, of: Callable[[str], Family]) -> Family:
    return of(request.param)


# ---- as plugins


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_is_one_short_file_on_public_names(name: str) -> None:
    path = FOLDER / f"{FAMILIES[name]}.py"
    source = Source(path, path.read_text(encoding="utf-8"), f"p2o_example.{FAMILIES[name]}")
    assert len(source.text.splitlines()) <= 150
    assert list(private_names(source)) == []
    assert not {found.module.partition(".")[0] for found in source.imports_on_load} & HEAVY


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_keeps_the_contract_of_calibrators(name: str) -> None:
    cases = checks_for(offer_of(name))
    assert len(cases) >= 6
    for case in cases:
        assert not case.expected_failure
        case()


# ---- p2o run


def test_a_run_ends_near_the_truth(family: Family, capsys: pytest.CaptureFixture[str]) -> None:
    done = family.run(capsys, "--witness", "depth/rings")
    assert done["status"] in ("converged", "rounds-spent"), done["reason"]
    within, error, before = parse_perturbation(family.example.within), done["error"], done["start_error"]
    assert error["rotation_deg"] < min(within.angle_deg, before["rotation_deg"])
    assert error["translation_m"] < min(within.distance_m, before["translation_m"])
    assert len(done["frames"]) == len(list(family.frames.iterdir()))
    # Edges that the method never saw meet there more often than by chance, and the verdict goes by them.
    assert done["agreement"]["odds_ratio"] > 2
    doubts = {reason["doubt"] for reason in done["verdict"]["reasons"]}
    assert ("little-agreement" in doubts) == (done["agreement"]["strength"] < PipelineOptions().min_strength)
    # The edges ask for another pose only where the result is off by more than good results of other methods.
    assert doubts <= {"little-agreement"} or (doubts == {"led-away"} and error["rotation_deg"] > 0.3)


def test_without_a_word_about_it_results_are_checked_by_the_default_witness(
    of: Callable[[str], Family], capsys: pytest.CaptureFixture[str]
) -> None:
    done = of("hand-eye-poses").run(capsys, "--frames", "0-3")
    assert done["status"] == "converged", done["reason"]
    assert done["agreement"]["odds_ratio"] > 1
    assert set(done["recipe"]["options"]) >= {"witness", "witness-cloud"}


# ---- studies


@dataclass(frozen=True)
class Bench:
    """A study of one family with two starts, in a folder of its own."""

    family: Family
    root: Path

    @property
    def text(self) -> str:
        lines = [
            'name = "family"',
            'title = "One family"',
            f'perturb = "{self.family.example.perturb}"',
            "seeds = 2",
            f"joint = {str(self.family.example.joint).lower()}",
            "[[dataset]]",
            'name = "frames"',
            f'data = "folder:{self.family.frames}"',
            "[[row]]",
            f'label = "{self.family.name}"',
            f'calibrator = "{self.family.name}"',
            'witness = "depth/rings"',
        ]
        return "\n".join(lines) + "\n"

    def start(self) -> Ablation:
        """Run the study, or go on with it, as a fresh process would."""
        worker._features.values.clear()
        worker._frames.values.clear()
        worker._stages.clear()
        file = StudyFile(parse_study(self.text), self.text, "test")
        plugins = Plugins(files=(str(self.family.plugin),))
        return ablate(
            file, self.root / "out", plugins=plugins, workers=Workers(1), cache=FeatureCache(self.root / "cache")
        )

    def forget(self, seed: int) -> None:
        """Delete the rows of one start."""
        rows = Rows(self.root / "out")
        [study] = rows.studies
        kept = [row for row in rows.each(study) if row.seed != seed]
        assert len(kept) == len(list(rows.each(study))) - 1
        rows.rewrite(study, kept)


def test_a_study_resumes_and_prepares_every_frame_once(
    family: Family, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, prepared = Bench(family, tmp_path), []
    prepare = GuardedCalibrator.prepare
    monkeypatch.setattr(
        GuardedCalibrator, "prepare", lambda self, frame: prepared.append(frame.name) or prepare(self, frame)
    )
    first = bench.start()
    assert (first.computed, len(first.rows), first.missing) == (2, 2, [])
    assert sorted(prepared) == sorted(path.name for path in family.frames.iterdir())
    within = parse_perturbation(family.example.within)
    for row in first.rows:
        assert row.solved, row.reason
        assert row.rotation_deg < within.angle_deg
        assert row.translation_m < within.distance_m
        assert row.figures["odds_ratio"] is not None
        assert row.trust in ("trusted", "doubtful")
    assert bench.start().computed == 0

    def refuse(self: Any, frame: p2o.Frame) -> Any:
        raise AssertionError(f"{frame.name} is prepared again")

    monkeypatch.setattr(GuardedCalibrator, "prepare", refuse)
    bench.forget(seed=1)
    again = bench.start()
    assert again.computed == 1
    for row, before in zip(again.rows, first.rows, strict=True):
        np.testing.assert_allclose(row.estimate, before.estimate, atol=1e-9)


def test_a_row_of_a_study_is_what_a_run_gives(
    of: Callable[[str], Family], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    family = of("hand-eye-poses")
    [row] = [row for row in Bench(family, tmp_path).start().rows if row.seed == 0]
    run = family.run(capsys, "--witness", "depth/rings", "--seed", "0")
    np.testing.assert_allclose(row.estimate, run["camera_from_lidar"], atol=1e-9)
    assert row.figures["odds_ratio"] == pytest.approx(run["agreement"]["odds_ratio"], rel=0.01)


# ---- hand-eye


def plugin(name: str) -> Any:
    """Return the module of a family's plugin."""
    return sys.modules[offer_of(name).method.build.__module__]


def moments(camera_from_lidar: Any, steps: Any, sequence: str = "drive") -> list[Any]:
    """Return the moments of a rig whose LiDAR moves by steps (N, 6) from frame to frame."""
    lidar = [np.eye(4)]
    for step in se3.exp(np.reshape(steps, (-1, 6))):
        lidar.append(lidar[-1] @ step)
    camera = [camera_from_lidar @ pose @ se3.inverse(camera_from_lidar) for pose in lidar]
    Moment = plugin("hand-eye-poses").Moment
    return [Moment(str(number), sequence, *poses) for number, poses in enumerate(zip(lidar, camera, strict=True))]


def built(name: str, **options: Any) -> Any:
    method = offer_of(name).method
    return method.build(method.options(**options))


TRUTH = se3.exp(np.array([1.2, -1.1, 1.3, 0.3, -0.1, 0.2]))
OPPOSITE = TRUTH @ se3.exp(np.array([0.0, 0.0, np.pi, 5.0, 0.0, 0.0]))
TURNS = np.random.default_rng(0).normal(size=(5, 6)) * [0.2, 0.2, 0.2, 1, 1, 1]


def test_exact_motions_give_the_exact_extrinsic_from_any_start() -> None:
    for start in (TRUTH, OPPOSITE):
        result = built("hand-eye-poses").solve(moments(TRUTH, TURNS), start)
        assert result.status is Status.CONVERGED
        np.testing.assert_allclose(result.camera_from_lidar, TRUTH, atol=1e-9)


def test_several_drives_are_used_together_and_never_mixed() -> None:
    # Every drive alone has too few frames, or turns about one axis only.
    drives = [
        [[0.3, 0, 0, 1, 0, 0], [0.2, 0, 0, 1, 0.5, 0]],
        [[0, 0, 0.3, 1, 0, 0]],
        [[0, 0.4, 0, 1, 0, 0.2]],
    ]
    parts = [moments(TRUTH, steps, f"drive {number}") for number, steps in enumerate(drives)]
    for part in parts:
        assert not built("hand-eye-poses").solve(part, OPPOSITE).status.solved
    result = built("hand-eye-poses").solve([moment for part in parts for moment in part], OPPOSITE)
    np.testing.assert_allclose(result.camera_from_lidar, TRUTH, atol=1e-9)


@pytest.mark.parametrize(
    ("steps", "status", "word"),
    [
        ([[0, 0, turn, 1, 0, 0] for turn in (0.3, -0.2, 0.4, 0.1)], Status.NOT_OBSERVABLE, "second"),
        ([[0, 0, 0, 1, 0.1, 0]] * 4, Status.NOT_OBSERVABLE, "second"),
        (TURNS[:1], Status.TOO_FEW_MATCHES, "2 frames"),
        ([], Status.TOO_FEW_MATCHES, "1 frame"),
    ],
)
def test_motions_that_leave_the_extrinsic_open_return_the_start_with_a_reason(
    steps: Any, status: Status, word: str
) -> None:
    result = built("hand-eye-poses").solve(moments(TRUTH, steps), OPPOSITE)
    assert result.status is status
    assert word in result.reason
    np.testing.assert_array_equal(result.camera_from_lidar, OPPOSITE)


def test_hand_eye_needs_no_start(of: Callable[[str], Family]) -> None:
    near, far = (of("hand-eye-poses").solve(perturb=perturb) for perturb in ("0deg 0m", "180deg 100m"))
    assert far.status is Status.CONVERGED
    np.testing.assert_array_equal(near.camera_from_lidar, far.camera_from_lidar)


def test_frames_without_poses_are_refused_before_anything_runs() -> None:
    registry = Registry.load(extra_files=[FOLDER / "hand_eye.py"])
    with pytest.raises(p2o.InputError, match="hand-eye-poses needs it"):
        p2o.calibrate(stage.frame(), calibrator="hand-eye-poses", registry=registry)


# ---- checkerboards


def test_one_board_is_too_few_and_boards_that_face_one_way_do_not_tell(of: Callable[[str], Family]) -> None:
    boards = of("checkerboard")
    one = boards.solve("0")
    assert one.status is Status.TOO_FEW_MATCHES
    np.testing.assert_allclose(one.camera_from_lidar, one.start, atol=1e-12)
    frame = _frame(boards, 0)
    method = built("checkerboard")
    same = method.solve([method.prepare(frame)] * 4, frame.camera_from_lidar)
    assert same.status is Status.NOT_OBSERVABLE
    np.testing.assert_allclose(same.camera_from_lidar, frame.camera_from_lidar, atol=1e-12)


def test_a_frame_whose_board_is_not_found_is_passed_over(of: Callable[[str], Family]) -> None:
    frames = [_frame(of("checkerboard"), number) for number in range(5)]
    method, truth = built("checkerboard"), frames[0].camera_from_lidar
    prepared = [method.prepare(frame) for frame in frames]
    black = p2o.Image(np.zeros_like(frames[4].image.rgb), frames[4].camera)
    blind = method.prepare(p2o.Frame("blind", black, frames[4].cloud, targets=frames[4].targets))
    assert blind.boards == []
    with_it, without = method.solve([*prepared[:4], blind], truth), method.solve(prepared[:4], truth)
    np.testing.assert_array_equal(with_it.camera_from_lidar, without.camera_from_lidar)
    assert with_it.frames[-1] == "blind"


def _frame(family: Family, number: int) -> p2o.Frame:
    return open_dataset(f"folder:{family.frames}", Registry.load())[number]


# ---- the network


def test_it_halves_the_error_of_starts_on_frames_that_it_never_saw(of: Callable[[str], Family]) -> None:
    glances = of("regressor")
    method = built("regressor")
    frames = [_frame(glances, number) for number in range(len(list(glances.frames.iterdir())))]
    prepared = [method.prepare(frame.without_truth()) for frame in frames]
    truth, size = frames[0].camera_from_lidar, parse_perturbation("3deg 0.2m")
    errors = []
    for seed in range(10):
        found = method.solve(prepared, size.start(truth, np.random.default_rng(seed))).camera_from_lidar
        errors.append(p2o.pose_error(found, truth))
    assert max(error.rotation_deg for error in errors) < 1.5
    assert max(error.translation_m for error in errors) < 0.1


def test_it_learns_through_p2o_train_and_its_weights_are_used(
    of: Callable[[str], Family], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    glances, out = of("regressor"), tmp_path / "trained"
    words = ["--plugin", str(glances.plugin), "--data", f"folder:{glances.frames}", "--out", str(out), "--quiet"]
    words += ["--frames", "0-1", "--set", "iterations=3"]
    assert main(["train", "regressor", *words]) == 0
    weights = out / "weights.safetensors"
    assert capsys.readouterr().out.splitlines()[-2] == str(weights)
    assert weights.stat().st_size < 200_000
    assert len(list(out.glob("labels/*/*.npz"))) == 2
    before = weights.read_bytes()
    weights.unlink()
    assert main(["train", "regressor", *words]) == 0
    assert weights.read_bytes() == before, "the same training gives the same bits"
    capsys.readouterr()
    own = glances.run(capsys, "--frames", "0", "--witness", "none", "--set", f"calibrator.weights={weights}")
    shipped = glances.run(capsys, "--frames", "0", "--witness", "none")
    assert own["camera_from_lidar"] != shipped["camera_from_lidar"]


def test_weights_that_are_none_are_an_error_of_the_plugin(of: Callable[[str], Family], tmp_path: Path) -> None:
    bad = tmp_path / "bad.safetensors"
    bad.write_bytes(b"no weights")
    with pytest.raises(p2o.P2OError, match="regressor"):
        of("regressor").solve("0", options={"calibrator": {"weights": str(bad)}})
