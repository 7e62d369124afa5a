"""Objects in boxes of both sensors: the files, and scenes of cuboids that only the truth lays together."""

import json

import numpy as np
import p2o
import pytest
from p2o.errors import InputError
from p2o.problems.problem import pose_from_chart
from p2o_baselines.segments.atop import Atop, AtopOptions, BoxFile, Cuboid, Objects, Road, Sight, grounded, read_objects

CAMERA = p2o.Camera.pinhole(500.0, 500.0, 400.0, 150.0, 800, 300)
TRUTH = p2o.se3.make([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], (0.1, -0.1, -0.3))
CARS = [
    (9.0, 2.5, 20.0),
    (13.0, -3.0, -5.0),
    (18.0, 4.0, 80.0),
    (24.0, -2.0, 0.0),
    (15.0, 7.5, 10.0),
    (30.0, 6.0, 35.0),
]
GROUND = np.array([0.0, 0.0, 1.0, 1.7])


def scene(lift_m=0.0):
    """Return a file's content: cars on the road, and the rectangles around them at the truth."""
    cuboids = [
        {"kind": "car", "centre": [x, y, -0.95 + lift_m], "size": [4.2, 1.8, 1.5], "yaw_deg": yaw} for x, y, yaw in CARS
    ]
    boxes = []
    for x, y, yaw in CARS:
        corners = Cuboid(kind="car", centre=(x, y, -0.95), size=(4.2, 1.8, 1.5), yaw_deg=yaw).corners
        uv = np.clip(CAMERA.project(p2o.se3.apply(TRUTH, corners)), 0, [799, 299])
        boxes.append({"kind": "car", "uv": [*uv.min(axis=0), *uv.max(axis=0)]})
    return {"boxes": boxes, "cuboids": cuboids}


def solved(tmp_path, content, start=None, **options):
    """Return the result of one frame with these boxes."""
    (tmp_path / "a_b.json").write_text(json.dumps(content))
    start = pose_from_chart(TRUTH, np.array([0.02, -0.02, 0.015, 0.06, -0.05, 0.08])) if start is None else start
    method = Atop(AtopOptions(boxes=str(tmp_path), **options))
    return method.solve([Road("a/b", CAMERA, GROUND)], start)


def far(result):
    """Return how far a result is from the truth, in degrees and metres."""
    away = result.camera_from_lidar @ p2o.se3.inverse(TRUTH)
    return p2o.se3.angle_deg(away), p2o.se3.distance_m(away)


def test_objects_lie_upon_each_other_at_the_truth():
    objects = Objects.of(BoxFile.model_validate(scene()))
    sight = Sight(CAMERA, objects.boxes, objects.corners, objects.same_kind > 0)
    for overlap in (False, True):
        assert np.allclose(sight.costs(TRUTH[None], overlap=overlap), 0.0, atol=1e-9)


def test_objects_of_other_kinds_do_not_belong_together():
    content = scene()
    for box in content["boxes"]:
        box["kind"] = "person"
    objects = Objects.of(BoxFile.model_validate(content))
    sight = Sight(CAMERA, objects.boxes, objects.corners, objects.same_kind > 0)
    assert (sight.costs(TRUTH[None], overlap=True) == 1.0).all()


def test_it_solves_a_road_with_six_cars(tmp_path):
    rotation_deg, translation_m = far(solved(tmp_path, scene()))
    assert rotation_deg < 0.2
    assert translation_m < 0.1


def test_cuboids_that_float_are_put_onto_the_ground(tmp_path):
    corners = Objects.of(BoxFile.model_validate(scene(lift_m=0.2))).corners
    assert np.allclose(grounded(corners, GROUND, 0.5)[:, :4, 2], -1.7)
    assert np.array_equal(grounded(corners, GROUND, 0.1), corners)


def test_without_boxes_the_start_is_handed_back(tmp_path):
    result = Atop(AtopOptions()).solve([Road("a", CAMERA, GROUND)], TRUTH)
    assert result.status is p2o.Status.NO_FEATURES
    assert "calibrator.boxes" in result.reason
    assert solved(tmp_path, {}).status is p2o.Status.NO_FEATURES


def test_too_few_objects_are_said_so(tmp_path):
    content = scene()
    del content["cuboids"][2:]
    result = solved(tmp_path, content)
    assert result.status is p2o.Status.TOO_FEW_MATCHES
    assert "3 are needed" in result.reason


def test_the_truth_is_not_improved_upon(tmp_path):
    assert solved(tmp_path, scene(), TRUTH).status is p2o.Status.NO_IMPROVEMENT


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ([], "not a JSON object"),
        ({"boxes": [{"kind": "car", "uv": [1, 2, 3]}]}, "uv"),
        ({"cuboids": [{"kind": "car", "centre": [0, 0, 0], "size": [1, 0, 1]}]}, "size"),
        ({"cubes": []}, "cubes"),
    ],
)
def test_files_that_hold_something_else_are_refused(tmp_path, content, what):
    (tmp_path / "a.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=what):
        read_objects(str(tmp_path), "a")
