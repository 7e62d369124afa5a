"""Learned regressors: what networks see, the algebra of what they say, training, weights, staged use."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import p2o
import pytest
import torch
from p2o import InputError, Recipe, Registry, Status, TrainingGroup, TrainingProgress, se3
from p2o.arrays import Float
from p2o_baselines.learned import calibnet, calibrcnn, lccnet, regnet, rggnet
from p2o_baselines.regressors import losses, method, poses, staged, training
from p2o_baselines.regressors import network_input as inputs
from p2o_baselines.regressors.batch import Batch, correction
from p2o_baselines.regressors.design import CALIBNET, LCCNET, Design
from p2o_baselines.regressors.method import weights_files
from p2o_baselines.regressors.network_input import Crop, NetworkInput, network_input_of
from p2o_baselines.regressors.options import Augmentation, RegressorOptions, TrainingOptions
from p2o_baselines.regressors.sample import (
    Reach,
    Sample,
    augment,
    draw_view,
    flat,
    labelled_image,
    sample_of,
)
from p2o_baselines.regressors.staged import Stage, StagedRegressor
from p2o_baselines.regressors.weights_file import Trained, read_weights, write_weights

METHODS: tuple[ModuleType, ...] = (calibnet, calibrcnn, lccnet, regnet, rggnet)
DATA = "synthetic:?scenes=2&place=street&width_px=414&height_px=125&lidar=hdl-32e&right=false"
NUMBERS = {"rotation-vector": 6, "quaternion": 7, "dual-quaternion": 8}
"""Outputs of a network by the form of its pose."""
STILL = Augmentation(zoom=1, mirror=False, light=0, thin=1)
SIZE = (48, 160)


@pytest.fixture(scope="module")
def frames() -> list[p2o.Frame]:
    return list(Recipe.of(data=DATA).resolve(Registry.load()).dataset())


@pytest.fixture(scope="module")
def labels(frames: list[p2o.Frame], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("labels")
    paths = [folder / f"{number}.npz" for number in range(len(frames))]
    for frame, path in zip(frames, paths, strict=True):
        path.write_bytes(method.label(frame))
    return paths


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.manual_seed(0)


def some_pose(rng: np.random.Generator, angle: float = 0.3, metres: float = 1.0) -> Float:
    turn, shift = rng.normal(size=(2, 3))
    return se3.exp(np.r_[angle * turn, metres * shift])


def tensor(*poses_: Float) -> torch.Tensor:
    return torch.from_numpy(np.stack(poses_))


# ---- what networks see


@pytest.mark.parametrize("model", ["pinhole", "opencv"])
def test_a_sweep_is_drawn_where_the_cameras_own_model_projects_it(frames: list[p2o.Frame], model: str) -> None:
    frame = frames[0]
    if model == "opencv":
        camera = p2o.Camera("OPENCV", 414, 125, (*frame.camera.params, -0.1, 0.02, 0.001, 0.0))
        frame = replace(frame, image=replace(frame.image, camera=camera, right=None, baseline_m=None))
    network_input = network_input_of(frame, SIZE, 10**6)
    pose = some_pose(np.random.default_rng(1), 0.03, 0.1) @ frame.camera_from_lidar
    there = se3.apply(pose, frame.cloud.xyz)
    cells = np.rint(Crop.of(frame.camera, SIZE).cells(frame.camera.project(there), SIZE))
    [found] = network_input.drawn(pose)
    assert (found > 0).sum() > 500
    for v, u in np.argwhere(found > 0)[::7]:
        inside = (cells == [u, v]).all(axis=1) & (there[:, 2] <= inputs.FARTHEST_M)
        assert found[v, u] == pytest.approx(inputs.nearness(there[inside, 2].min()), abs=1e-5)


def painted(rng: np.random.Generator) -> Sample:
    """Return a sample whose picture and reflectance are both one smooth function of the direction of sight."""
    height, width, focal = 150, 500, 300.0
    v, u = np.indices((height, width))
    ray = np.stack([(u - 249.5) / focal, (v - 74.5) / focal, np.ones_like(u, dtype=float)], axis=-1)

    def paint(x: Float) -> Float:
        flat_ = x[..., :2] / x[..., 2:]
        return 0.5 + 0.25 * np.sin(5 * flat_[..., 0] + 1) + 0.2 * np.sin(9 * flat_[..., 1])

    directions = np.column_stack([rng.uniform(-2, 2, 60_000), rng.uniform(-1, 1, 60_000), np.ones(60_000)])
    xyz = directions * rng.uniform(5, 40, (60_000, 1))
    rgb = np.repeat(np.rint(255 * paint(ray))[..., None], 3, axis=2).astype(np.uint8)
    nan = np.full((4, 4), np.nan)
    return Sample("x", "", rgb, np.array([focal, focal]), np.array([249.5, 74.5]), xyz, paint(xyz), np.eye(4), nan, nan)


@pytest.mark.parametrize("changed", [{}, {"zoom": 2.0}, {"mirror": True}, {"turn_deg": 8.0}])
def test_cuts_mirrors_and_turns_change_picture_and_sweep_alike(changed: dict[str, float]) -> None:
    rng = np.random.default_rng(5)
    sample, augmentation = painted(rng), STILL.model_copy(update={"most_points": 60_000, **changed})
    for _ in range(4):
        seen = replace(draw_view([(5.0, 0.5)], augmentation, rng), wrong=np.eye(4))
        made = augment(sample, seen, SIZE, ("reflectance",), 16, augmentation, rng)
        inner = made.rgb[..., 0] > 0
        known = (made.sweep[0] > 0) & inner
        assert known.sum() > 1000
        off = np.abs(made.sweep[0] - made.rgb[..., 0] / 255)[known]
        assert np.median(off) < 0.01
        assert np.quantile(off, 0.95) < 0.04


def test_a_sample_is_undone_by_its_correction() -> None:
    rng = np.random.default_rng(6)
    sample = painted(rng)
    seen = draw_view([(10.0, 0.5)], STILL, rng)
    made = augment(sample, seen, SIZE, ("nearness",), 64, STILL, rng)
    right = augment(sample, replace(seen, wrong=np.eye(4)), SIZE, ("nearness",), 64, STILL, np.random.default_rng(7))
    assert right.sweep[0] == pytest.approx(right.true_nearness)
    assert np.abs(made.sweep[0] - made.true_nearness).mean() > 0.05
    back = se3.apply(made.correction, made.xyz)
    lines = np.cross(back[:, None] / np.linalg.norm(back, axis=1)[:, None, None], sample.xyz[None])
    assert np.linalg.norm(lines, axis=2).min(axis=1).max() < 1e-3
    assert made.correction @ made.start == pytest.approx(sample.camera_from_lidar)


def test_a_lens_is_taken_out_of_a_lesson(frames: list[p2o.Frame]) -> None:
    frame = frames[0]
    camera = p2o.Camera("OPENCV", 414, 125, (*frame.camera.params, -0.2, 0.03, 0.0, 0.0))
    rgb, pinhole = flat(replace(frame.image, camera=camera, right=None, baseline_m=None))
    uv = np.array([[60.0, 30.0], [300.0, 100.0]])
    bent = camera.project(pinhole.rays(uv))
    for (u, v), (x, y) in zip(uv.astype(int), bent, strict=True):
        near = frame.image.rgb[int(y) : int(y) + 2, int(x) : int(x) + 2].astype(float)
        assert near.min() - 1 <= rgb[v, u].mean() <= near.max() + 1


def test_a_sample_is_what_was_written_and_can_be_drawn(frames: list[p2o.Frame], labels: list[Path]) -> None:
    sample = Sample.load(labels[0])
    assert sample.name == frames[0].name
    assert sample.rgb.shape == (125, 414, 3)
    assert sample.camera_from_lidar == pytest.approx(frames[0].camera_from_lidar)
    assert labelled_image(sample).shape == sample.rgb.shape
    with pytest.raises(InputError, match="cannot be used for training"):
        sample_of(frames[0].without_truth())
    (labels[0].parent / "broken.npz").write_bytes(b"x")
    with pytest.raises(InputError, match="label file cannot be read"):
        Sample.load(labels[0].parent / "broken.npz")


# ---- what networks say


def test_rotations_quaternions_and_dual_quaternions_are_the_same_poses() -> None:
    rng = np.random.default_rng(8)
    some = tensor(*[some_pose(rng) for _ in range(20)])
    assert poses.dual_quaternion_pose(poses.dual_quaternion_of(some)).numpy() == pytest.approx(some.numpy())
    assert poses.quaternion_rotation(poses.quaternion_of(some[:, :3, :3])).numpy() == pytest.approx(
        some[:, :3, :3].numpy()
    )
    vectors = rng.uniform(-1.5, 1.5, size=(20, 3))
    ours = poses.rotation(torch.from_numpy(vectors))
    for vector, matrix in zip(vectors, ours.numpy(), strict=True):
        assert matrix == pytest.approx(se3.exp(np.r_[vector, 0, 0, 0])[:3, :3])
    assert poses.angle_of(ours).numpy() == pytest.approx(np.linalg.norm(vectors, axis=1), abs=1e-5)
    assert (poses.inverse(some) @ some).numpy() == pytest.approx(np.broadcast_to(np.eye(4), (20, 4, 4)), abs=1e-12)


@pytest.mark.parametrize("form", NUMBERS)
def test_zeros_correct_nothing_and_have_gradients(form: str) -> None:
    raw = torch.zeros(2, NUMBERS[form], requires_grad=True)
    reach = torch.tensor([[0.1, 0.5]] * 2)
    said = correction(raw, reach, form)
    assert said.detach().numpy() == pytest.approx(np.broadcast_to(np.eye(4), (2, 4, 4)))
    losses.geodesic(said, tensor(*[some_pose(np.random.default_rng(1))] * 2).float(), reach).backward()
    assert torch.isfinite(raw.grad).all()
    assert raw.grad.abs().sum() > 0


def lessons_batch(window: int = 1, reach: Reach = (5.0, 0.3)) -> Batch:
    rng = np.random.default_rng(11)
    sample = painted(rng)
    seen = draw_view([reach], STILL, rng)
    made = [augment(sample, seen, SIZE, ("nearness",), 128, STILL, rng) for _ in range(4)]
    return Batch.of(made, window, torch.device("cpu"))


def test_numbers_count_in_the_reach_of_the_stage() -> None:
    raw = torch.tensor([[0.5, 0.0, 0.0, 0.0, -1.0, 0.0]])
    said = correction(raw, torch.tensor([[0.2, 0.3]]), "rotation-vector")[0].numpy()
    assert said == pytest.approx(se3.make(se3.exp(np.array([0.1, 0, 0, 0, 0, 0.0]))[:3, :3], [0, -0.3, 0]), abs=1e-6)


def test_features_match_where_those_of_points_are_alike_in_both_sensors() -> None:
    batch = lessons_batch(reach=(25.0, 0.3))
    # Features that say where on the sphere a cell looks: known for the picture, and for the sweep by its true places.
    v, u = torch.meshgrid(torch.linspace(-1, 1, 12), torch.linspace(-1, 1, 40), indexing="ij")
    place = torch.stack([torch.sin(9 * u), torch.cos(9 * u), torch.sin(4 * v), torch.cos(4 * v)])[None].repeat(
        4, 1, 1, 1
    )
    still = replace(batch, xyz=poses.apply(batch.correction, batch.xyz), correction=torch.eye(4).repeat(4, 1, 1))
    right = float(losses.matching(place, place, SIZE, still))
    wrong = float(losses.matching(place, place, SIZE, batch))
    chance = float(losses.matching(place, torch.randn_like(place), SIZE, still))
    assert right < 0.8 * min(wrong, chance)


@pytest.mark.parametrize("loss", ["geodesic", "points", "chamfer", "photometric"])
def test_losses_of_geometry_are_least_at_the_truth(loss: str) -> None:
    batch = lessons_batch()
    if loss == "geodesic":
        right, none = (
            float(losses.geodesic(said, batch.correction, batch.reach))
            for said in (batch.correction, torch.eye(4).repeat(4, 1, 1))
        )
        assert right < 1e-3 < none
        return
    lossy = getattr(losses, loss)
    right, none = (float(lossy(each, batch)) for each in (batch.correction, torch.eye(4).repeat(4, 1, 1)))
    assert right < 0.3 * none


# ---- networks


@pytest.mark.parametrize("which", METHODS, ids=lambda module: module.DESIGN.name)
def test_networks_of_both_sizes_are_as_large_as_the_page_says(which: ModuleType) -> None:
    own: Design = which.DESIGN
    page = (Path(__file__).parents[2] / "docs/comparison-learned.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| `{own.name}` \|(.*)\|$", page, re.MULTILINE)
    assert row is not None
    for size in ("paper", "small"):
        with torch.device("meta"):
            network = own.network(size)
            height, width = own.inputs[size]
            seen = torch.zeros(2, 3, height, width), torch.zeros(2, len(own.channels), height, width)
            assert network.eval()(*seen, torch.ones(2, 2), 2).shape == (2, NUMBERS[own.form])
        assert f"{sum(each.numel() for each in network.parameters()) / 1e6:.2f}" in row[1]
        assert f"{height} x {width}" in row[1]


# ---- training


class _StoppedError(Exception):
    pass


def learn(
    which: Design, labels: Sequence[Path], out: Path, *, stop: int = 0, **said: object
) -> tuple[Path, list[TrainingProgress]]:
    told: list[TrainingProgress] = []

    def report(progress: TrainingProgress) -> None:
        told.append(progress)
        if progress.step == stop:
            raise _StoppedError

    options = TrainingOptions(**{"batch": 6, "validate_every": 5, "points": 32, "stages": ((10.0, 0.3),), **said})
    path = out / "weights.safetensors"
    with suppress(_StoppedError):
        path = training.train(which, options, [TrainingGroup("x", labels, 1.0)], labels[:1], out, report)
    return path, told


@pytest.mark.system
@pytest.mark.parametrize("which", METHODS, ids=lambda module: module.DESIGN.name)
def test_every_network_learns(labels: list[Path], tmp_path: Path, which: ModuleType) -> None:
    still = {"augmentation": STILL, "average": 0.0, "validate_every": 20}
    _, told = learn(which.DESIGN, labels, tmp_path, iterations=60, learning_rate=3e-3, **still)
    assert told[-1].loss < 0.95 * told[0].loss
    assert told[-1].validation is not None


def test_a_training_goes_on_as_if_it_had_not_stopped(labels: list[Path], tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    brief = {"iterations": 2, "validate_every": 1, "batch": 2}
    learn(calibrcnn.DESIGN, labels, whole, **brief)
    learn(calibrcnn.DESIGN, labels, broken, stop=1, **brief)
    path, told = learn(calibrcnn.DESIGN, labels, broken, **brief)
    assert [each.step for each in told] == [2]
    assert path.read_bytes() == (whole / "weights.safetensors").read_bytes()
    with pytest.raises(InputError, match="holds another training"):
        learn(calibrcnn.DESIGN, labels, broken, seed=1, **brief)
    with pytest.raises(InputError, match="holds another training"):
        learn(calibnet.DESIGN, labels, broken, **brief)
    with pytest.raises(InputError, match="nothing to train on"):
        training.train(calibnet.DESIGN, TrainingOptions(), [], [], tmp_path)


# ---- weights and use


def test_branches_of_one_method_begin_another(tmp_path: Path) -> None:
    first = written(calibnet.DESIGN, tmp_path / "calibnet.safetensors")
    network = training._initial_network(calibrcnn.DESIGN, TrainingOptions(branches=str(first)))
    taken, _ = read_weights(first, calibnet.DESIGN)
    assert torch.equal(network.picture[0][0].weight, taken.picture[0][0].weight)
    with pytest.raises(InputError, match="another method"):
        training._initial_network(calibrcnn.DESIGN, TrainingOptions(from_weights=str(first)))


def written(which: Design, path: Path, stages: tuple[Reach, ...] = CALIBNET) -> Path:
    write_weights(which.network("small"), Trained(which.name, "small", stages), path)
    return path


def test_weights_of_another_method_and_what_is_none_are_refused(tmp_path: Path) -> None:
    good = written(calibnet.DESIGN, tmp_path / "calibnet.safetensors")
    network, trained = read_weights(good, calibnet.DESIGN)
    assert trained.stages == CALIBNET
    assert not network.training
    with pytest.raises(InputError, match="weights belong to another method") as caught:
        read_weights(good, rggnet.DESIGN)
    assert caught.value.hint == "--calibrator calibnet"
    (tmp_path / "no.safetensors").write_bytes(b"\xff" * 100)
    for name in ("no", "absent"):
        with pytest.raises(InputError, match=r"cannot be read|missing|no such|not found|is not there"):
            read_weights(tmp_path / f"{name}.safetensors", calibnet.DESIGN)
    lying = tmp_path / "lying.safetensors"
    write_weights(rggnet.DESIGN.network("small"), Trained("calibnet", "small", CALIBNET), lying)
    with pytest.raises(InputError, match="no weights of calibnet"):
        read_weights(lying, calibnet.DESIGN)
    with pytest.raises(p2o.MethodUnavailable, match="no weights of calibnet of size paper are installed"):
        weights_files("paper", calibnet.DESIGN)


def test_a_run_reads_weights_and_gives_every_stage_its_turn(tmp_path: Path) -> None:
    path = written(lccnet.DESIGN, tmp_path / "w.safetensors", LCCNET[2:])
    ran = p2o.calibrate(
        DATA,
        frames="::2",
        calibrator="lccnet",
        perturb="2deg 0.1m",
        witness="none",
        options={"calibrator": {"weights": str(path)}},
    )
    [row] = ran.rows
    assert row.result.status == Status.ROUNDS_SPENT
    assert row.result.reason.startswith("3 corrections of lccnet")
    assert row.result.accuracy is None


class _Constant(torch.nn.Module):
    """A network that always says the same."""

    def __init__(self, *numbers: float) -> None:
        super().__init__()
        self.numbers = torch.tensor(numbers)

    def forward(self, picture: torch.Tensor, sweep: torch.Tensor, reach: torch.Tensor, window: int) -> torch.Tensor:
        return self.numbers.repeat(len(picture), 1)


def regressor(said: _Constant, *reaches: Reach) -> StagedRegressor:
    stages = [Stage(said, reach) for reach in reaches]
    return StagedRegressor(calibnet.DESIGN, "small", stages, RegressorOptions(), torch.device("cpu"))  # type: ignore[arg-type]


def test_stages_follow_each_other_and_count_in_their_own_reach(frames: list[p2o.Frame]) -> None:
    whole = regressor(_Constant(0.1, 0, 0, 0, 0, 0), (10.0, 1.0), (5.0, 1.0))
    truth = frames[0].camera_from_lidar
    result = whole.solve([whole.prepare(frame) for frame in frames], truth)
    expected = se3.exp(np.r_[np.radians(1.0 + 0.5), np.zeros(5)]) @ truth
    assert result.camera_from_lidar == pytest.approx(expected, abs=1e-6)
    assert "median of 2 frames" in result.reason


def test_no_stage_is_used_where_the_sweep_is_out_of_view(frames: list[p2o.Frame]) -> None:
    whole = regressor(_Constant(*[0.0] * 6), (10.0, 1.0))
    up = se3.exp(np.r_[np.radians(85), np.zeros(5)]) @ frames[0].camera_from_lidar
    result = whole.solve([whole.prepare(frames[0])], up)
    assert result.status == Status.NO_FEATURES
    assert result.camera_from_lidar == pytest.approx(up)


# ---- shipped weights


def test_one_bad_frame_does_not_move_the_median() -> None:
    rng = np.random.default_rng(15)
    truth = some_pose(rng)
    near = [some_pose(rng, 0.001, 0.002) @ truth for _ in range(4)]
    found = staged.median(np.stack([*near, some_pose(rng, 1.0, 5.0) @ truth]))
    assert se3.angle_deg(se3.inverse(found) @ truth) < 0.3


def test_frames_of_one_drive_are_looked_at_together() -> None:
    def seen(group: str) -> NetworkInput:
        blank = p2o.Camera.pinhole(100, 100, 79.5, 23.5, 160, 48)
        return NetworkInput("x", group, blank, np.zeros((48, 160, 3), np.uint8), np.zeros((0, 3)), np.zeros(0))

    assert staged.windows([seen(group) for group in "aaaabb"], 3) == [[0, 1, 2], [3], [4, 5]]
    assert staged.windows([seen("a")] * 2, 1) == [[0], [1]]


def test_weights_of_the_package_for_research_are_small_and_state_their_licence() -> None:
    for which in METHODS:
        [path] = weights_files("small", which.DESIGN)
        assert path.stat().st_size < 2e6
        _, trained = read_weights(*weights_files("small", which.DESIGN), which.DESIGN)
        assert trained.about["licence"].startswith("research only")
        assert trained.size == "small"


@pytest.mark.real
@pytest.mark.parametrize("which", METHODS, ids=lambda module: module.DESIGN.name)
def test_shipped_networks_come_nearer_on_frames_of_their_rig_that_they_have_not_seen(
    kitti_raw: Path, which: ModuleType
) -> None:
    test = json.loads((Path(__file__).parents[2] / "baselines/p2o_baselines/suites/splits.json").read_text())["test"]
    ran = p2o.calibrate(
        f"kitti-raw:{kitti_raw}",
        frames=",".join(test[::6]),
        calibrator=which.DESIGN.name,
        perturb="euler camera 10deg 0.25m",
        witness="none",
        seed=3,
    )
    off = [(row.start_error.rotation_deg, row.error.rotation_deg) for row in ran.rows if row.error and row.start_error]
    assert len(off) == 4
    assert np.mean([end for _, end in off]) < 0.6 * np.mean([start for start, _ in off])
