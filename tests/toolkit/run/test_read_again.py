"""Joint calibrations of many frames hold none of them, and find the same as if they held all."""

from __future__ import annotations

import gc
import threading
import weakref
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Frame, Kind, Method, Recipe, Registry
from p2o.cli.out_dir import OutDir
from p2o.run.recipe import open_dataset
from p2o.run.run import run

from tests.toolkit.offered import registry_with


class Counted:
    """Frames that are made anew whenever they are asked for; `most` is how many were alive at once."""

    def __init__(self, frames: list[Frame]) -> None:
        self.frames, self.alive, self.most = frames, [], 0
        self.names = tuple(frame.name for frame in frames)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Frame:
        its = self.frames[index]
        image = p2o.Image(its.image.rgb.copy(), its.camera, depth_m=its.image.depth_m)
        frame = Frame(its.name, image, p2o.Cloud(its.cloud.xyz, its.cloud.ring), its.camera_from_lidar)
        self.alive.append(weakref.ref(image))
        gc.collect()
        self.most = max(self.most, sum(one() is not None for one in self.alive))
        return frame


@pytest.fixture(autouse=True, scope="module")
def _quick_collection() -> Iterator[None]:
    """Leave the objects of other tests out of the collections of garbage of this module."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    dataset = open_dataset("synthetic:?scenes=6&width_px=414&height_px=125&right=false", p2o.Registry.load())
    return [dataset[number] for number in range(6)]


def joint(data: Counted) -> p2o.Result:
    return p2o.calibrate(data, extractor="depth/rings", perturb="1deg 0.05m", joint=True).result


def test_many_frames_are_read_again_and_give_the_same(frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    held, again = Counted(frames), Counted(frames)
    expected = joint(held)
    monkeypatch.setattr("p2o.run.run.MAX_FRAMES_IN_MEMORY", 2)
    found = joint(again)
    np.testing.assert_array_equal(found.camera_from_lidar, expected.camera_from_lidar)
    assert found.frames == expected.frames == held.names
    assert found.warnings == expected.warnings
    assert held.most == len(frames)
    assert again.most < len(frames) - 1


def test_of_too_many_frames_an_even_subset_is_read(frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("p2o.run.run.MOST_JOINT_FRAMES", 3)
    result = joint(Counted(frames))
    assert result.frames == tuple(frames[number].name for number in (0, 2, 4))
    assert [text for text in result.warnings if "3 of 6 frames are not used" in text]
    np.testing.assert_array_equal(result.camera_from_lidar, joint(Counted(frames[::2])).camera_from_lidar)


def test_a_plain_function_gets_many_frames_one_at_a_time(frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    names = []

    def whole(given: Sequence[Frame], start: np.ndarray) -> p2o.Result:
        for frame in given:
            assert frame.camera_from_lidar is None
            names.append(frame.name)
        return p2o.Result(tuple(names), start, start, p2o.Status.CONVERGED, "done")

    registry = registry_with((Kind.CALIBRATOR, Method(name="whole", build=lambda _: whole, summary="A function.")))
    monkeypatch.setattr("p2o.run.run.MAX_FRAMES_IN_MEMORY", 2)
    data = Counted(frames)
    recipe = Recipe.of(data=None, calibrator="whole", witness="none", perturb="1deg 0.05m", joint=True)
    plan = recipe.resolve(registry)
    assert run(plan, data).result.frames == data.names == tuple(names)
    assert data.most < len(frames) - 1


def counting(method: Method, calls: Counter[str]) -> Method:
    """Return the method under another name; it counts how often it is asked."""

    def build(options: Any) -> Any:
        stage = method.build(options)

        def counted(data: Any) -> Any:
            calls[method.name] += 1
            return stage(data)

        return counted

    return replace(method, name=f"counted-{method.name}", build=build)


@pytest.mark.parametrize("focal_px", [700.0, 1400.0], ids=["as it is", "looked at smaller"])
def test_pictures_of_frames_that_are_read_again_show_features_that_were_found_once(
    frames: list[Frame], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, focal_px: float
) -> None:
    installed, calls = Registry.load(), Counter()
    counted = ((Kind.IMAGE_EXTRACTOR, "depth"), (Kind.CLOUD_EXTRACTOR, "rings"))
    offers = [(kind, counting(installed.find(kind, name).method, calls)) for kind, name in counted]
    monkeypatch.setattr("p2o.run.run.MAX_FRAMES_IN_MEMORY", 2)
    recipe = Recipe.of(data=None, extractor="counted-depth/counted-rings", perturb="1deg 0.05m", joint=True)
    plan = recipe.resolve(registry_with(*offers))
    folder = OutDir.prepared(str(tmp_path)).for_frames([frame.name for frame in frames])
    cameras = [replace(frame.camera, params=(focal_px, focal_px, *frame.camera.params[2:])) for frame in frames]
    images = [replace(frame.image, camera=camera) for frame, camera in zip(frames, cameras, strict=True)]
    read = [replace(frame, image=image) for frame, image in zip(frames, images, strict=True)]
    run(plan, Counted(read), on_progress=folder.write)
    assert calls == {"depth": len(frames), "rings": len(frames)}
    assert len(list(tmp_path.glob("*/after.png"))) == len(frames)


def test_a_bad_frame_among_many_is_named(frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Counted):
        def __getitem__(self, index: int) -> Frame:
            if index == 4:
                raise p2o.InputError("the image is cut short")
            return super().__getitem__(index)

    monkeypatch.setattr("p2o.run.run.MAX_FRAMES_IN_MEMORY", 2)
    with pytest.raises(p2o.InputError, match=f"cut short; a joint .* needs every frame: leave {frames[4].name}"):
        joint(Broken(frames))


@pytest.mark.parametrize("parallel", [True, False])
def test_frames_of_a_joint_calibration_are_read_at_once_where_the_dataset_allows_it(
    frames: list[Frame], monkeypatch: pytest.MonkeyPatch, parallel: bool
) -> None:
    both = threading.Barrier(2)
    threads: set[int] = set()

    class Meeting(Counted):
        def __getitem__(self, index: int) -> Frame:
            threads.add(threading.get_ident())
            if parallel:
                both.wait(timeout=30)  # broken unless two are read at the same time
            return super().__getitem__(index)

    method = Method(name="meeting", build=lambda _: Meeting(frames), summary="Frames.", parallel=parallel)
    monkeypatch.setattr("p2o.runtime.native.cores", lambda: 2)
    words = {"extractor": "depth/rings", "init": "given", "perturb": "1deg 0.05m", "joint": True}
    plan = Recipe.of(data="meeting:", **words).resolve(registry_with((Kind.DATASET, method)))
    assert run(plan).result.frames == tuple(frame.name for frame in frames)
    assert (len(threads) == 1) == (not parallel)


def test_recipes_say_whether_their_methods_take_several_frames_at_once() -> None:
    registry = p2o.Registry.load()
    for extractor, parallel in (("p2ornet/rings", True), ("p2ornet/range-view", True), ("depth/rings", False)):
        assert Recipe.of(extractor=extractor).resolve(registry).assembly().parallel == parallel
