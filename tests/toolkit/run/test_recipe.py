"""Words become a plan: names found, options validated, stages fitted, all before any data are read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Frame, InputError, Kind, Method, PluginError, Recipe, Registry, Result, Status, UnknownNameError
from p2o.host import calibration_file
from p2o.run.isolated import isolated
from p2o.run.outcome import Run
from p2o.run.recipe import open_exporter
from p2o.run.words import parse_settings, split_data
from p2o_formats import hooks as formats
from p2o_testing import stage

from tests.toolkit.offered import registry_with


class Sized(p2o.Options):
    size: int = p2o.field(3, ge=1, le=9, help="A size.")
    seed: int = p2o.field(7, ge=0, help="A seed.")


class Unwritable(p2o.Options):
    call: Any = p2o.field(len, help="A value that JSON has no form for.")


class TooLarge(p2o.Options):
    size: int = p2o.field(10**400, help="An integer that readers of JSON refuse.")


class InvalidDefault(p2o.Options):
    size: int = p2o.field("seven", help="A default of another type.")


class Rooted(p2o.Options):
    root: str = p2o.field(..., help="A folder.")
    scenes: int = p2o.field(1, help="How many.")


def never(*_: Any) -> None:
    raise AssertionError("nothing may be built or read while a recipe is resolved")


class Offered:
    """Methods of every slot that refuse to be built, for checks that need no building."""

    offers = (
        (Kind.IMAGE_EXTRACTOR, "sided", {"gives": {"image-edges", "side"}}),
        (Kind.IMAGE_EXTRACTOR, "plain", {"gives": {"image-edges"}}),
        (Kind.IMAGE_EXTRACTOR, "stereoscopic", {"gives": {"image-edges", "side"}, "needs": {"right"}}),
        (Kind.IMAGE_EXTRACTOR, "radar", {"gives": {"image-edges", "side"}, "needs": {"radar"}}),
        (Kind.CLOUD_EXTRACTOR, "rings", {"gives": {"cloud-edges", "side"}}),
        (Kind.CLOUD_EXTRACTOR, "blunt", {"gives": {"cloud-edges"}}),
        (Kind.CLOUD_EXTRACTOR, "mute", {"gives": {"cloud-points", "side"}}),
        (Kind.MATCHER, "directed", {"needs": {"side", "image-edges", "cloud-edges"}, "gives": {"pairs"}}),
        (Kind.MATCHER, "nearest", {"needs": {"image-edges", "cloud-edges"}, "gives": {"pairs"}, "options": Sized}),
        (Kind.MATCHER, "scalar", {"gives": {"objective"}}),
        (Kind.SOLVER, "least-squares", {"needs": {"pairs"}, "options": Sized}),
        (Kind.SOLVER, "simplex", {"needs": {"objective"}}),
        (Kind.INITIALIZER, "given", {}),
        (Kind.CALIBRATOR, "whole", {"options": Sized}),
        (Kind.CALIBRATOR, "unwritable", {"options": Unwritable}),
        (Kind.CALIBRATOR, "too-large", {"options": TooLarge}),
        (Kind.CALIBRATOR, "invalid-default", {"options": InvalidDefault}),
        (Kind.DATASET, "synthetic", {"options": Sized, "gives": {"rings"}}),
        (Kind.DATASET, "files", {"options": Rooted}),
    )

    def _of(self, kind: Kind) -> list[Method]:
        return [Method(name=n, build=never, summary="A test.", **more) for k, n, more in self.offers if k == kind]  # type: ignore[arg-type]


for _kind in Kind:
    setattr(Offered, _kind.hook, p2o.hookimpl(lambda self, kind=_kind: self._of(kind)))
REGISTRY = Registry.of(acme=Offered())
WORDS: dict[str, Any] = {
    "data": "synthetic:",
    "extractor": "sided/rings",
    "matcher": "directed",
    "solver": "least-squares",
    "init": "given",
}


def resolved(**words: Any) -> Any:
    return Recipe.of(**{**WORDS, **words}).resolve(REGISTRY)


def test_what_is_not_said_takes_the_default_of_the_recipe_and_resolving_builds_nothing() -> None:
    assert Recipe.of(matcher=None, frames=None, seed=3) == Recipe(seed=3)
    assert Recipe.of(seed=2**63 - 1).seed == 2**63 - 1, "which fits in every store"
    with pytest.raises(InputError, match=r"recipe\.seed is out of bounds; .*than or equal to 9223372036854775807"):
        Recipe.of(seed=2**63)
    with pytest.raises(UnknownNameError, match=r"unknown recipe option 'matchr'.*did you mean matcher"):
        Recipe.of(matchr="ogm")
    names = {stage: part.offer.name for stage, part in resolved().parts.items()}
    assert names == {**WORDS, "data": "synthetic", "extractor": "sided", "cloud": "rings"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        # `scalar` would take these edges too, but gives no pairs: a replacement that is named fits the whole recipe.
        ({"extractor": "plain/rings"}, "plain gives no side; directed needs it; try --matcher nearest"),
        ({"extractor": "sided/blunt"}, "blunt gives no side; directed needs it; try --matcher nearest"),
        (
            {"extractor": "sided/mute"},
            "mute gives no cloud-edges; directed needs it; no installed matcher fits in its place "
            "(`p2o methods --matrix` shows what does)",
        ),
        ({"matcher": "scalar"}, "scalar gives no pairs; least-squares needs it; try --solver simplex"),
        (
            {"extractor": "radar/rings"},
            "synthetic gives no radar; radar needs it; try --extractor sided/rings or stereoscopic/rings",
        ),
    ],
)
def test_stages_that_do_not_fit_are_refused_with_what_would(words: dict[str, str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        resolved(**words)
    assert str(caught.value) == message


@pytest.mark.parametrize("extractor", ["sided", "sided/", "/rings", "a/b/c", ""])
def test_an_extractor_is_a_pair(extractor: str) -> None:
    with pytest.raises(InputError, match="IMAGE/CLOUD"):
        resolved(extractor=extractor)


@pytest.mark.parametrize(
    ("word", "held"),
    [
        ("sequence", {"sequence": "drive"}),
        ("frame-time", {"time_s": 0.0}),
        ("lidar-pose", {"lidar_world_from_lidar": np.eye(4)}),
        ("camera-pose", {"camera_world_from_camera": np.eye(4)}),
        ("targets", {"targets": (p2o.Checkerboard(7, 5, 0.1, 1.0, 0.8),)}),
    ],
)
def test_a_method_may_need_what_only_frames_of_drives_or_with_targets_hold(word: str, held: dict[str, Any]) -> None:
    method = Method(name="asking", build=never, summary="A test.", needs=frozenset({word}))
    recipe = Recipe.of(data=None, calibrator="asking", witness="none")
    plan = recipe.resolve(registry_with((Kind.CALIBRATOR, method)))
    frame = stage.frame()
    with pytest.raises(InputError, match=f"the frame has no {word}; asking needs it"):
        plan.check_frame(frame)
    plan.check_frame(replace(frame, **held))
    stereo = resolved(extractor="stereoscopic/rings")
    stereo.check_frame(frame)
    blind = replace(frame, image=p2o.Image(frame.image.rgb, frame.camera))
    with pytest.raises(InputError, match="stage: the frame has no right; stereoscopic needs it; try --extractor sided"):
        stereo.check_frame(blind)


def test_a_whole_method_takes_the_place_of_the_stages() -> None:
    plan = Recipe.of(data="synthetic:", calibrator="whole").resolve(REGISTRY)
    assert list(plan.parts) == ["data", "calibrator"]
    assert "matcher" not in plan.described()
    with pytest.raises(InputError, match="whole method; expected no matcher, solver beside it"):
        Recipe.of(data="synthetic:", calibrator="whole", matcher="nearest", solver="simplex").resolve(REGISTRY)
    with pytest.raises(InputError, match="options for matcher, which this recipe does not use"):
        Recipe.of(data="synthetic:", calibrator="whole", options={"matcher": {"size": 1}}).resolve(REGISTRY)
    with pytest.raises(InputError, match="options for the pipeline"):
        Recipe.of(data="synthetic:", calibrator="whole", options={"pipeline": {"rounds": 1}}).resolve(REGISTRY)


def test_texts_and_values_of_options_mean_the_same_also_of_lists_and_nested_names() -> None:
    by_text = resolved(matcher="nearest", options=parse_settings(["matcher.size=4", "pipeline.reach_px=2e1"]))
    by_value = resolved(matcher="nearest", options={"matcher": {"size": 4}, "pipeline": {"reach_px": 20}})
    assert by_text.described() == by_value.described()
    assert by_text.described()["options"]["matcher"] == {"size": 4, "seed": 0}
    assert by_text.described()["options"]["pipeline"]["reach_px"] == 20.0
    assert parse_settings(["data.sizes=[1, 2]", "data.a.b=x=y", "data.none=null", "data.size=1", "data.size=2"]) == {
        "data": {"sizes": [1, 2], "a": {"b": "x=y"}, "none": None, "size": "2"}
    }


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("matcher.size=10", "matcher.size is out of bounds; expected less than or equal to 9; got 10"),
        ("matcher.size=big", "matcher.size is not valid; expected a valid integer.*; got big"),
        ("matcher.sise=1", "unknown matcher option 'sise'; expected one of: seed, size; did you mean size"),
        ("pipeline.rounds=0", "pipeline.rounds is out of bounds; expected greater than or equal to 1; got 0"),
        ("matchr.size=1", "--set: unknown stage 'matchr'.*did you mean matcher"),
        ("matcher.size", "--set: cannot read the setting; expected STAGE.FIELD=VALUE.*; got matcher.size"),
        ("calibrator.size=1", "options for calibrator, which this recipe does not use"),
        ("matcher.size=[1", r"\[1: the value is not YAML"),
    ],
)
def test_bad_options_are_told_with_path_value_and_bound(setting: str, message: str) -> None:
    with pytest.raises(InputError, match=message.replace("?", r"\?")):
        resolved(matcher="nearest", options=parse_settings([setting]))


def test_an_option_called_seed_follows_the_recipes_seed_and_the_description_of_a_plan_repeats_it() -> None:
    plan = resolved(matcher="nearest", seed=5, options={"solver": {"seed": 1}})
    seeds = {stage: part.options.seed for stage, part in plan.parts.items() if hasattr(part.options, "seed")}
    assert seeds == {"data": 5, "matcher": 5, "solver": 1}
    assert resolved(data="synthetic:?seed=2", seed=5).parts["data"].options.seed == 2
    plan = resolved(matcher="nearest", perturb="2deg 0.1m", seed=4, joint=True, options={"solver": {"size": 2}})
    again = Recipe.of(**plan.described()).resolve(REGISTRY)
    assert again.described() == plan.described()
    whole = Recipe.of(data="synthetic:", calibrator="whole").resolve(REGISTRY)
    assert Recipe.of(**whole.described()).resolve(REGISTRY).described() == whole.described()


@pytest.mark.parametrize(
    ("text", "name", "options"),
    [
        ("synthetic:", "synthetic", {}),
        ("synthetic:?scenes=4&seed=1", "synthetic", {"scenes": "4", "seed": "1"}),
        ("kitti-raw:a:b?c", "kitti-raw", {"root": "a:b?c"}),
        ("kitti-raw:/a?camera=0", "kitti-raw", {"root": "/a", "camera": "0"}),
        ("synthetic:?", "synthetic", {}),
        ("files:~/kitti", "files", {"root": "/home/ada/kitti"}),
    ],
)
def test_data_text_is_a_dataset_a_path_and_options(
    text: str, name: str, options: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/home/ada")
    assert split_data(text) == (name, options)


def test_a_dataset_with_and_without_a_path() -> None:
    options = resolved(data="files:/a?scenes=2").parts["data"].options
    assert (options.root, options.scenes) == ("/a", 2)
    with pytest.raises(InputError, match="dataset files needs a path; expected files:PATH"):
        resolved(data="files:")
    with pytest.raises(InputError, match="dataset synthetic takes no path; expected synthetic:; got /a"):
        resolved(data="synthetic:/a")
    with pytest.raises(InputError, match=r"options follow a question mark: synthetic:\?scenes=2"):
        resolved(data="synthetic:scenes=2")
    with pytest.raises(InputError, match=r"/a/b: no such file or folder; expected DATASET:PATH"):
        resolved(data="/a/b")
    with pytest.raises(UnknownNameError, match=r"unknown dataset 'fils'.*did you mean files\?"):
        resolved(data="fils:/a")
    with pytest.raises(InputError, match="--perturb: cannot read the size"):
        resolved(perturb="two degrees", data="files:/a")


def test_an_export_is_a_name_and_a_path(tmp_path: Any) -> None:
    registry = Registry.load(environ={"P2O_PLUGINS": "p2o-calib"})
    _, path = open_exporter(f"json:{tmp_path}/a.json", registry)
    assert path == tmp_path / "a.json"
    with pytest.raises(InputError, match="an export needs a path"):
        open_exporter("json:", registry)
    with pytest.raises(UnknownNameError, match="unknown exporter 'jsn'"):
        open_exporter("jsn:a", registry)


# ---- running


class Spy:
    """A dataset and a whole method that notes what it is handed."""

    def __init__(self, frames: list[Frame], answer: Any = None) -> None:
        self.frames, self.answer = frames, answer
        self.seen: list[tuple[list[Frame], Any]] = []

    @p2o.hookimpl
    def p2o_datasets(self) -> Any:
        def opened(options: Any) -> Any:
            class Listed(list[Frame]):
                names = tuple(frame.name for frame in self.frames)

            return Listed(self.frames)

        yield Method(name="listed", build=opened, summary="A test.")

    @p2o.hookimpl
    def p2o_calibrators(self) -> Any:
        def calibrate(frames: Any, start: Any) -> Result:
            self.seen.append((list(frames), np.array(start)))
            if isinstance(self.answer, Exception):
                raise self.answer
            names = tuple(frame.name for frame in frames)
            pose = start if self.answer is None else self.answer
            return Result(names, start, pose, Status.CONVERGED, "because it is a test")

        yield Method(name="spy", build=lambda options: calibrate, summary="A test.")

    def run(self, **words: Any) -> Run:
        return p2o.calibrate(**{"data": "listed:", "calibrator": "spy", "registry": Registry.of(acme=self), **words})


def framed(name: str, truth: Any = None, start: Any = None) -> Frame:
    frame = stage.frame()
    return Frame(name, frame.image, frame.cloud, camera_from_lidar=truth, start=start)


TRUTH = stage.camera_from_lidar()
OTHER = TRUTH @ p2o.se3.make(translation=(0.1, 0.0, 0.0))


def test_a_perturbed_start_is_as_wrong_as_asked_and_follows_seed_and_frame_and_the_truth_is_not_seen() -> None:
    frames = [framed(name, TRUTH) for name in "abc"]
    assert all(frame.camera_from_lidar is None for seen, _ in _seen(frames, 0) for frame in seen)
    starts = {seed: [start for _, start in _seen(frames, seed)] for seed in (0, 1)}
    for start in starts[0]:
        error = p2o.pose_error(start, TRUTH)
        assert error.rotation_deg == pytest.approx(2.0, abs=1e-9)
        assert error.translation_m == pytest.approx(0.1, abs=1e-9)
    assert not np.allclose(starts[0][0], starts[0][1])
    assert not np.allclose(starts[0][0], starts[1][0])
    # A frame starts alike whichever others are run with it.
    [(_, alone)] = _seen(frames, 0, frames="2")
    assert np.array_equal(alone, starts[0][2])


def _seen(dataset: list[Frame], seed: int, **words: Any) -> Any:
    spy = Spy(dataset)
    spy.run(perturb="2deg 0.1m", seed=seed, **words)
    return spy.seen


def test_a_start_of_the_data_is_taken_before_the_truth_whose_use_is_said_and_without_both_there_is_nothing() -> None:
    for frame, used, remark in (
        (framed("a", TRUTH, start=OTHER), OTHER, ""),
        (framed("a", TRUTH), TRUTH, "the start is the calibration that the data give"),
    ):
        spy = Spy([frame])
        assert remark in "".join(spy.run().result.warnings[:1])
        assert np.allclose(spy.seen[0][1], used, atol=1e-12)
    with pytest.raises(InputError, match="a: there is no start to calibrate from"):
        Spy([framed("a")]).run()
    with pytest.raises(InputError, match="a: the truth is not known, so it cannot be perturbed"):
        Spy([framed("a", start=OTHER)]).run(perturb="1deg")


def test_the_file_of_a_start_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads, read = [], calibration_file.read_calibration

    def counted(*words: Any, **more: Any) -> Any:
        reads.append(words)
        return read(*words, **more)

    file = tmp_path / "start.txt"
    file.write_text("\n".join(" ".join(map(str, row)) for row in OTHER.tolist()))
    monkeypatch.setattr(calibration_file, "read_calibration", counted)
    spy = Spy([framed("a", TRUTH), framed("b", TRUTH)])
    registry = Registry.of(formats, acme=spy)
    p2o.calibrate("listed:", calibrator="spy", start=str(file), registry=registry)
    assert [start for _, start in spy.seen] == [pytest.approx(OTHER), pytest.approx(OTHER)]
    with isolated(Recipe.of(data="listed:", calibrator="spy", start=str(file)), (), ()) as apart:
        Recipe.of(**apart.words).resolve(registry)
    assert len(reads) == 1


def test_a_start_may_be_given_in_python_but_not_with_a_perturbation() -> None:
    spy = Spy([framed("a", TRUTH)])
    spy.run(start=OTHER)
    assert np.allclose(spy.seen[0][1], OTHER, atol=1e-12)
    with pytest.raises(InputError, match="both a start and a perturbation"):
        spy.run(start=OTHER, perturb="1deg")
    with pytest.raises(InputError, match="start has the wrong shape"):
        spy.run(start=np.eye(3))


def test_the_order_of_the_chosen_frames_does_not_change_a_joint_calibration() -> None:
    words: dict[str, Any] = {
        "data": "synthetic:?frames_per_scene=3&width_px=414&height_px=125&right=false",
        "extractor": "depth/rings",
        "perturb": "1deg 0.05m",
    }
    first, other = (
        p2o.calibrate(frames=frames, joint=True, witness="none", **words).result for frames in ("0-2", "2,0,1")
    )
    assert other.frames == first.frames
    assert other.camera_from_lidar.tobytes() == first.camera_from_lidar.tobytes()


class Unnamed:
    """A whole method that names frames by what it prepared of them."""

    def prepare(self, frame: Frame) -> Any:
        return 3

    def solve(self, prepared: Any, start: Any) -> Result:
        return Result(tuple(str(one) for one in prepared), start, start, Status.CONVERGED, "because it is a test")


def test_frames_of_a_result_are_named_by_the_frames() -> None:
    method = Method(name="unnamed", build=lambda options: Unnamed(), summary="A test.")
    frames, registry = [framed("a", TRUTH), framed("b", TRUTH)], registry_with((Kind.CALIBRATOR, method))
    words: dict[str, Any] = {"calibrator": "unnamed", "witness": "none", "registry": registry}
    assert [row.result.frames for row in p2o.calibrate(frames, **words).rows] == [("a",), ("b",)]
    assert p2o.calibrate(frames, joint=True, **words).result.frames == ("a", "b")


def test_frames_of_two_rigs_are_not_calibrated_jointly_but_rounded_and_unknown_poses_are_one_rig() -> None:
    spy = Spy([framed("a", TRUTH), framed("b", OTHER)])
    with pytest.raises(InputError, match=r"frames a and b have different extrinsics.*0 deg and 0\.1 m apart"):
        spy.run(joint=True)
    assert len(spy.run().rows) == 2
    rounded = TRUTH @ p2o.se3.exp(np.array([5e-7, 0, -5e-7, 0, 4e-7, 0]))
    spy = Spy([framed("a", TRUTH), framed("b", rounded), framed("c")])
    assert spy.run(joint=True, perturb="2deg 0.1m").result.frames == ("a", "b", "c")
    [(frames, _)] = spy.seen
    assert [frame.name for frame in frames] == ["a", "b", "c"], "one call with all frames"


def test_a_cloud_that_does_not_tell_its_rings_is_calibrated_with_a_warning() -> None:
    frame = stage.frame()
    order = np.random.default_rng(0).permutation(len(frame.cloud))
    cloud = p2o.Cloud(frame.cloud.xyz[order] + [0, 0, 0.3])
    moved = p2o.se3.make(np.eye(3), [0, 0, -0.3])
    told = Frame("stage", frame.image, cloud, camera_from_lidar=TRUTH @ moved)
    run = p2o.calibrate(told, extractor="depth/rings", perturb="1deg 0.05m")
    assert run.rows[0].error.rotation_deg < 0.5
    assert any(
        "stage: the rings of the cloud are not observable" in text and "range-view" in text
        for text in run.result.warnings
    )


def test_frames_may_be_handed_over_in_python() -> None:
    spy = Spy([])
    frames = [framed("a", TRUTH), framed("b", TRUTH)]
    run = spy.run(data=frames, frames="b")
    assert [row.result.frames for row in run.rows] == [("b",)]
    assert run.rows[0].result.recipe["data"] is None
    with pytest.raises(InputError, match="there are no frames"):
        spy.run(data=[])
    with pytest.raises(InputError, match="entry 0 of the frames is not a frame"):
        spy.run(data=[3])


def test_a_plugin_that_fails_ends_its_frame_not_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("P2O_STRICT", "P2O_DEBUG"):
        monkeypatch.delenv(name, raising=False)
    spy = Spy([framed("a", TRUTH), framed("b", TRUTH)], ValueError("no such luck"))
    run = spy.run()
    assert [row.result.status for row in run.rows] == [Status.STAGE_FAILED] * 2
    assert "plugin acme: calibrator 'spy' raised ValueError" in run.rows[0].result.reason
    assert np.allclose(run.rows[0].result.camera_from_lidar, TRUTH)
    assert not run.solved
    monkeypatch.setenv("P2O_DEBUG", "1")
    with pytest.raises(PluginError, match="no such luck"):
        spy.run()


def test_progress_is_told_around_every_calibration_and_results_name_recipe_seed_and_versions() -> None:
    told: list[tuple[int, int, str, bool]] = []
    spy = Spy([framed("a", TRUTH), framed("b", TRUTH)])
    run = spy.run(
        seed=6, perturb="1deg", on_progress=lambda p: told.append((p.done, p.total, p.name, p.row is not None))
    )
    assert told == [(0, 2, "a", False), (1, 2, "a", True), (1, 2, "b", False), (2, 2, "b", True)]
    result = run.rows[1].result
    assert (result.seed, result.recipe["perturb"], result.recipe["calibrator"]) == (6, "1deg", "spy")
    assert {"python", "numpy", "p2o-calib"} <= set(result.versions)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("unwritable", "its options cannot be stored in results: .*expected finite numbers, texts, lists and dicts"),
        ("too-large", "its options cannot be stored in results: .* at most 1000 bits"),
        ("invalid-default", "the default of calibrator.size is not valid; expected a valid integer.*got seven"),
    ],
)
def test_options_that_no_result_can_contain_are_a_fault_of_the_plugin(name: str, text: str) -> None:
    with pytest.raises(PluginError, match=f"plugin acme: calibrator '{name}': {text}"):
        Recipe(data="synthetic:", calibrator=name).resolve(REGISTRY)


def test_an_option_that_the_user_has_set_wrongly_is_no_fault_of_the_plugin() -> None:
    with pytest.raises(InputError, match=r"^calibrator\.size is not valid; .* got eight") as caught:
        Recipe(data="synthetic:", calibrator="invalid-default", options={"calibrator": {"size": "eight"}}).resolve(
            REGISTRY
        )
    assert not isinstance(caught.value, PluginError)
