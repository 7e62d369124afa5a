from __future__ import annotations

import io
import pickle
import sqlite3
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from p2o import Camera, Cloud, Dataset, Frame, Registry, UnknownNameError, se3
from p2o.cli import main
from p2o.run.recipe import open_dataset
from p2o_datasets.bags.bag import Bag
from p2o_datasets.bags.overview import overview

from tests.bag_files import (
    FORMS,
    LIVOX,
    Said,
    camera_info,
    cloud,
    compressed,
    file_of,
    foxglove,
    header,
    image,
    messages_of,
    odometry,
    serialized,
    store_of,
    tf,
    transform,
    write_bag,
)

from .opened import opened, refused

CAMERA = Camera.pinhole(20, 20, 7, 5, 16, 12)
START_NS = 1_700_000_000_000_000_000
AXES = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
TRUTH = se3.exp(np.array([0.01, 0.02, -0.03, 0, 0, 0])) @ se3.make(AXES, [0.1, -0.2, -0.3])
dataset = partial(opened, "ros")


def points(seed: int, **more: Any) -> dict[str, Any]:
    """Return a sweep around the sensor, of four rings."""
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(-3, 3, 200)
    xyz = np.column_stack([np.cos(azimuth), np.sin(azimuth), rng.normal(0, 0.1, 200)]) * rng.uniform(4, 20, (200, 1))
    return {**{a: xyz[:, i].astype(np.float32) for i, a in enumerate("xyz")}, "ring": np.arange(200) % 4 + 0.0, **more}


def pixels(seed: int) -> Any:
    return np.random.default_rng(seed).integers(0, 256, (12, 16, 3), dtype=np.uint8)


def drive(
    count: int = 3, *, every_ns: int = 100_000_000, later_ns: int = 0, info: bool = True, **columns: Any
) -> list[Said]:
    """Return a recording: images, and sweeps `later_ns` after them."""
    said = [tf([transform("lidar", "camera", se3.inverse(TRUTH))], START_NS)]
    said += [camera_info("/camera_info", START_NS, CAMERA)] if info else []
    for number in range(count):
        time_ns = START_NS + number * every_ns
        said.append(image("/image_raw", time_ns, pixels(number)))
        said.append(cloud("/points", time_ns + later_ns, points(number, **columns)))
    return sorted(said, key=lambda message: message.time_ns)


@pytest.fixture(scope="module")
def synthetic() -> Sequence[Frame]:
    frames = open_dataset("synthetic:?scenes=2&width_px=320&height_px=120&right=false&lidar=vlp-16", Registry.load())
    # A bag holds single precision, and says nothing about motion.
    clouds = [
        Cloud(f.cloud.xyz.astype(np.float32), ring=f.cloud.ring, intensity=_single(f.cloud.intensity)) for f in frames
    ]
    return [replace(frame, cloud=cloud) for frame, cloud in zip(frames, clouds, strict=True)]


def _single(values: Any) -> Any:
    return None if values is None else values.astype(np.float32)


@pytest.mark.parametrize("form", FORMS)
def test_frames_come_out_of_a_bag_as_they_went_in(tmp_path: Path, form: str, synthetic: Sequence[Frame]) -> None:
    path = write_bag(tmp_path, messages_of(synthetic, START_NS), form)
    found = open_dataset(f"ros:{path}?tf=truth", Registry.load())
    assert isinstance(found, Dataset)
    assert found.names == ("drive/1700000000.000000000", "drive/1700000000.100000000")
    for number, (frame, source) in enumerate(zip(found, synthetic, strict=True)):
        assert np.array_equal(frame.image.rgb, source.image.rgb)
        assert np.array_equal(frame.cloud.xyz, source.cloud.xyz)
        assert np.array_equal(frame.cloud.ring, source.cloud.ring)
        assert np.array_equal(frame.cloud.intensity, source.cloud.intensity)
        assert frame.camera == source.camera
        assert np.allclose(frame.camera_from_lidar, source.camera_from_lidar, atol=1e-12)
        assert (frame.start, frame.cloud.time_s, frame.warnings) == (None, None, ())
        assert (frame.sequence, frame.time_s) == ("drive", pytest.approx(0.1 * number))


def test_tf_is_the_start_unless_it_is_said_to_be_the_truth_or_nothing(tmp_path: Path) -> None:
    path = write_bag(tmp_path, drive())
    frame = dataset(path)[0]
    assert frame.camera_from_lidar is None
    assert np.allclose(frame.start, TRUTH, atol=1e-12)
    assert np.allclose(dataset(path, tf="truth")[0].camera_from_lidar, TRUTH, atol=1e-12)
    ignored = dataset(path, tf="ignore")[0]
    assert (ignored.start, ignored.camera_from_lidar) == (None, None)


def test_a_mounting_that_is_sent_in_tf_over_and_over_is_as_good_as_static(tmp_path: Path) -> None:
    moving = [tf([transform("odom", "lidar", se3.make(translation=[i, 0, 0]))], START_NS + i, "/tf") for i in range(3)]
    still = [tf([transform("lidar", "camera", se3.inverse(TRUTH))], START_NS + i, "/tf") for i in range(3)]
    said = [message for message in drive() if message.topic != "/tf_static"]
    frame = dataset(write_bag(tmp_path, [*still, *moving, *said]))[0]
    assert np.allclose(frame.start, TRUTH, atol=1e-12)


def test_frames_of_tf_may_be_named(tmp_path: Path) -> None:
    other = tf([transform("lidar", "optical", np.eye(4)), transform("lidar", "camera", np.eye(4))], START_NS)
    path = write_bag(tmp_path, [other, *(m for m in drive() if m.topic != "/tf_static")])
    with pytest.raises(UnknownNameError, match=r"data.image_frame: unknown frame.*did you mean optical"):
        dataset(path, image_frame="opticl")
    apart = tf([transform("map", "world", np.eye(4))], START_NS + 1)
    parted = write_bag(tmp_path / "b", [other, apart, *drive()])
    with refused("no static transforms of TF connect lidar and world"):
        dataset(parted, image_frame="world")
    assert dataset(path, image_frame="optical", tf="truth").names


def test_a_bag_without_the_transform_has_no_start_and_says_so(tmp_path: Path) -> None:
    said = [m for m in drive() if m.topic != "/tf_static"]
    assert dataset(write_bag(tmp_path, said))[0].warnings == ()
    apart = tf([transform("map", "base", np.eye(4))], START_NS)
    path = write_bag(tmp_path / "b", [apart, *said])
    frame = dataset(path)[0]
    assert frame.start is None
    assert "no static transforms of TF connect lidar and camera: no initial guess" in frame.warnings[0]
    assert "frames of TF: base, map: choose with data.cloud_frame" in frame.warnings[0]
    with refused("no static transforms of TF connect"):
        dataset(path, tf="truth")


def test_the_rotation_of_rectified_pictures_is_part_of_the_extrinsic(tmp_path: Path) -> None:
    turn = se3.exp(np.array([0.02, -0.01, 0.03, 0, 0, 0]))
    info = camera_info("/camera_info", START_NS, CAMERA, r=turn[:3, :3].reshape(-1), d=np.full(5, 0.1))
    said = [m for m in drive(info=False) if m.topic != "/image_raw"]
    said += [image("/image_rect_color", START_NS + i * 10**8, pixels(i)) for i in range(3)]
    frame = dataset(write_bag(tmp_path, [info, *said]), tf="truth")[0]
    assert frame.camera == CAMERA
    assert np.allclose(frame.camera_from_lidar, turn @ TRUTH, atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_times_of_points_count_from_the_image(tmp_path: Path, form: str) -> None:
    later_s = np.linspace(0, 0.09, 200)
    said = drive(later_ns=20_000_000, t=(later_s * 1e9).round().astype(np.uint32))
    time_s = dataset(write_bag(tmp_path, said, form))[1].cloud.time_s
    assert np.allclose(time_s, later_s + 0.02, atol=2e-9)
    path = tmp_path / ("drive.bag" if form == "ros1" else "drive")
    shifted = dataset(path, image_offset_s=0.01)
    assert np.allclose(shifted[1].cloud.time_s, later_s + 0.01, atol=2e-9)
    assert shifted.names == dataset(path).names  # names are those of the stamps as they are
    assert dataset(path, point_times="none")[1].cloud.time_s is None


def test_livox_sweeps_have_times_and_no_rings(tmp_path: Path) -> None:
    def livox(number: int) -> Said:
        stamp_ns = START_NS + number * 100_000_000
        entries = [
            {"offset_time": 1000 * i, "x": 5.0, "y": 0.1 * i, "z": 0.2, "reflectivity": i, "tag": 0, "line": i % 4}
            for i in range(30)
        ]
        fields = {"header": header(stamp_ns, "lidar"), "timebase": stamp_ns, "point_num": 30, "points": entries}
        return Said("/livox/lidar", LIVOX, stamp_ns, fields)

    said = [m for m in drive() if m.topic != "/points"] + [livox(number) for number in range(3)]
    found = dataset(write_bag(tmp_path, said))[1].cloud
    assert found.ring is None
    assert found.intensity is not None
    assert np.allclose(found.xyz[:, 1], 0.1 * np.arange(30))
    assert np.allclose(found.time_s, 1e-6 * np.arange(30))


def test_each_image_and_each_sweep_is_of_one_frame(tmp_path: Path) -> None:
    said = [m for m in drive() if m.topic != "/image_raw"]
    said += [image("/image_raw", START_NS + 30_000_000 * i, pixels(i)) for i in range(9)]
    found = dataset(write_bag(tmp_path, said))
    assert found.names == tuple(f"drive/1700000000.{part}" for part in ("000000000", "090000000", "210000000"))
    assert np.array_equal(found[2].image.rgb, pixels(7))


def test_images_without_a_sweep_of_their_time_are_left_out(tmp_path: Path) -> None:
    lonely = image("/image_raw", START_NS + 10**9, pixels(0))
    found = dataset(write_bag(tmp_path, [*drive(), lonely]))
    assert len(found) == 3
    assert found.skipped == {"drive/1700000001.000000000": "no sweep within 0.05 s, the nearest is 0.8 s away"}
    with refused(r"is left out.*no sweep within"):
        found.frame("drive/1700000001.000000000")


def test_clocks_that_never_meet_are_said_and_shifted(tmp_path: Path) -> None:
    path = write_bag(tmp_path, drive(later_ns=7_000_000_000))
    with refused(r"no image of /image_raw has a sweep of the same time.*got 6.8 s.*data.image_offset_s"):
        dataset(path)
    assert len(dataset(path, image_offset_s=7.0)) == 3


def test_times_of_recording_are_taken_where_headers_have_none(tmp_path: Path) -> None:
    said = [
        replace(m, fields={**m.fields, "header": header(0, m.fields["header"]["frame_id"])})
        if m.topic in ("/image_raw", "/points")
        else m
        for m in drive()
    ]
    path = write_bag(tmp_path, said)
    with refused(r"messages of /image_raw have no stamps.*--set data.stamps=bag"):
        dataset(path)
    found = dataset(path, stamps="bag")
    assert found.names[1] == "drive/1700000000.100000000"
    assert np.array_equal(found[1].image.rgb, pixels(1))


def test_messages_that_were_recorded_at_one_time_are_told_apart(tmp_path: Path) -> None:
    said = [replace(message, time_ns=START_NS) for message in drive()]
    for form in FORMS:
        found = dataset(write_bag(tmp_path / form, said, form))
        assert [bool(np.array_equal(f.image.rgb, pixels(i))) for i, f in enumerate(found)] == [True] * 3


def test_frames_are_chosen_by_time_and_number(tmp_path: Path) -> None:
    path = write_bag(tmp_path, drive(10))

    def tenths(**options: Any) -> list[int]:
        return [int(name[-9:]) // 100_000_000 for name in dataset(path, **options).names]

    assert tenths() == list(range(10))
    assert tenths(every_s=0.3) == [0, 3, 6, 9]
    assert tenths(most=3) == [0, 4, 9]
    assert tenths(every_s=0.2, most=2) == [0, 8]
    with refused(r"the bag has no poses of the vehicle.*data.every_s"):
        dataset(path, every_m=1)


def test_frames_are_chosen_by_the_way_that_odometry_or_tf_tells(tmp_path: Path) -> None:
    # It stands still for half of the time, then drives a metre from frame to frame.
    places = [(START_NS + i * 50_000_000, max(0.0, (i - 10) * 0.5)) for i in range(20)]
    by_odometry = [odometry("/odom", time, (0, x, 0)) for time, x in places]
    by_tf = [tf([transform("odom", "base", se3.make(translation=[0, x, 0]), time)], time, "/tf") for time, x in places]
    mounting = tf([transform("base", "lidar", se3.make(translation=[1, 0, 0]))], START_NS - 1)
    for number, way in enumerate((by_odometry, [mounting, *by_tf])):
        path = write_bag(tmp_path / str(number), [*way, *drive(10)])
        found = dataset(path, every_m=2.0)
        assert [int(name[-9:]) // 100_000_000 for name in found.names] == [0, 7, 9]
    beyond = write_bag(tmp_path / "far", [odometry("/odom", START_NS, (1e300, 0, 0)), *drive()])
    with refused("the positions of the vehicle are implausible"):
        dataset(beyond, every_m=1)
    with pytest.raises(UnknownNameError, match="did you mean /odom"):
        dataset(tmp_path / "0" / "drive", every_m=1, odometry_topic="/odm")


def test_a_frame_reads_its_two_messages_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = pickle.loads(pickle.dumps(dataset(write_bag(tmp_path, drive(5)))))  # noqa: S301  (in another process, too)
    asked: list[tuple[str, int]] = []
    real = Bag.message

    def message(self: Bag, topic: str, time_ns: int, number: int = 0) -> Any:
        asked.append((topic, time_ns - START_NS))
        return real(self, topic, time_ns, number)

    monkeypatch.setattr(Bag, "message", message)
    frame = found[3]
    assert frame.name.endswith("300000000")
    assert np.array_equal(frame.image.rgb, pixels(3))
    assert asked == [("/image_raw", 300_000_000), ("/points", 300_000_000)]


def test_a_camera_file_stands_in_for_a_camera_info(tmp_path: Path) -> None:
    path = write_bag(tmp_path, drive(info=False))
    with refused(r"the bag has no CameraInfo.*--set data.camera=FILE"):
        dataset(path)
    camera = tmp_path / "camera.yaml"
    camera.write_text("{width: 16, height: 12, model: SIMPLE_PINHOLE, params: [20, 7, 5]}")
    assert dataset(path, camera=camera)[0].camera.model == "SIMPLE_PINHOLE"


def _short(said: Said, form: str, path: Path, cut: int) -> None:
    """Write a bag whose message of one topic lacks its last bytes."""
    store = store_of(form)
    data = serialized(store, said, form)
    file = path if form == "ros1" else file_of(path)
    with sqlite3.connect(file) as database:
        database.execute("UPDATE messages SET data = ? WHERE data = ?", (data[:-cut], data))
    database.close()


def test_one_bad_message_is_one_bad_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = drive()
    path = write_bag(tmp_path, said, "sqlite3")
    _short(next(m for m in said if m.topic == "/points"), "sqlite3", path, 40)
    assert main(["data", "check", f"ros:{path}"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert "BAD" in lines[0]
    assert "/points: the message is damaged or truncated" in lines[0]
    assert lines[-1] == "2 of 3 frames are good"


def test_a_message_without_a_whole_header_is_left_out(tmp_path: Path) -> None:
    said = drive()
    path = write_bag(tmp_path, said, "sqlite3")
    picture = next(m for m in said if m.topic == "/image_raw")
    _short(picture, "sqlite3", path, len(serialized(store_of("sqlite3"), picture, "sqlite3")) - 10)
    found = dataset(path)
    assert len(found) == 2
    assert "the message is damaged or truncated" in found.skipped["drive/image_raw/1700000000.000000000"]


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (lambda m: m.topic != "/image_raw", {}, "the bag has no topic of an image"),
        (lambda m: m.topic != "/points", {}, "the bag has no topic of a cloud"),
        (lambda m: True, {"cloud_topic": "/poins"}, "did you mean /points"),
        (lambda m: True, {"image_topic": "/points"}, "topic /points is not a topic of type image"),
        (lambda m: True, {"camera": "gone.yaml"}, "the calibration file is missing"),
    ],
)
def test_bags_that_cannot_be_used_are_one_line_and_status_2(
    tmp_path: Path, change: Any, options: dict[str, str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_bag(tmp_path, [message for message in drive() if change(message)])
    settings = [part for key, value in options.items() for part in ("--set", f"data.{key}={value}")]
    assert main(["data", "check", f"ros:{path}", *settings]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said
    assert "\n" not in said
    assert "Traceback" not in said


def test_a_picture_of_another_size_than_its_camera_is_bad(tmp_path: Path) -> None:
    said = [camera_info("/camera_info", START_NS, Camera.pinhole(20, 20, 7, 5, 16, 10)), *drive(info=False)]
    found = dataset(write_bag(tmp_path, said))
    with refused(r"/image_raw: the image size does not fit the camera.*16x10.*16x12"):
        found[0]


def test_a_pose_that_looks_the_wrong_way_round_is_told(tmp_path: Path) -> None:
    said = [tf([transform("lidar", "camera", TRUTH)], START_NS), *(m for m in drive() if m.topic != "/tf_static")]
    front = [m for m in said if m.topic != "/points"]
    xyz = se3.apply(se3.inverse(TRUTH), in_view())
    columns = {axis: xyz[:, i].astype(np.float32) for i, axis in enumerate("xyz")}
    frame = dataset(write_bag(tmp_path, [*front, cloud("/points", START_NS, columns)]))
    with refused(r"TF \(start\) looks like lidar_from_camera"):
        frame[0]


LIDAR_FROM_LINK = se3.inverse(TRUTH) @ se3.make(AXES)


def of_frame(name: str, *transforms: dict[str, Any]) -> list[Said]:
    """Return a recording whose images are in a frame of this name, with the transforms of TF."""
    said = [m for m in drive() if m.topic != "/tf_static"]
    for message in said:
        if message.topic == "/image_raw":
            message.fields["header"]["frame_id"] = name
    return [tf(list(transforms), START_NS), *said]


def test_a_link_without_an_optical_frame_has_body_axes(tmp_path: Path) -> None:
    path = write_bag(tmp_path, of_frame("camera_link", transform("lidar", "camera_link", LIDAR_FROM_LINK)))
    frame = dataset(path)[0]
    assert np.allclose(frame.start, TRUTH)
    assert "camera_link are assumed to be x forward" in frame.warnings[0]
    assert "--set data.camera_axes=optical" in frame.warnings[0]
    assert dataset(path, camera_axes="body")[0].warnings == ()
    as_optical = dataset(path, camera_axes="optical", tf="truth")[0].camera_from_lidar
    assert np.allclose(as_optical, se3.inverse(LIDAR_FROM_LINK))


def test_the_optical_frame_below_the_link_of_the_images_is_used(tmp_path: Path) -> None:
    link = transform("lidar", "camera_link", LIDAR_FROM_LINK @ se3.make(translation=[0.1, 0, 0]))
    optical = transform("camera_link", "camera_optical_frame", se3.make(np.transpose(AXES), [-0.1, 0, 0]))
    path = write_bag(tmp_path, of_frame("camera_link", link, optical))
    frame = dataset(path)[0]
    assert np.allclose(frame.start, TRUTH)
    assert "its optical frame camera_optical_frame of TF is used" in frame.warnings[0]
    frame = dataset(path, image_frame="camera_link")[0]
    assert np.allclose(frame.start, se3.make(translation=[0, 0, -0.1]) @ TRUTH)


def test_a_frame_of_tf_with_two_parents_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = [transform(parent, "camera", se3.inverse(TRUTH)) for parent in ("lidar", "base")]
    path = write_bag(tmp_path, of_frame("camera", *both))
    assert main(["data", "check", f"ros:{path}"]) == 2
    assert "frame camera has several parents; expected one parent; got base, lidar" in capsys.readouterr().err
    assert dataset(path, tf="ignore")[0].start is None


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["RawImage", "CompressedImage"])
def test_images_of_foxglove_are_those_of_ros(tmp_path: Path, form: str, kind: str) -> None:
    buffer = io.BytesIO()
    PIL.Image.fromarray(pixels(0)).save(buffer, "PNG")
    one = image("/image_raw", START_NS, pixels(0), frame="camera")
    one = one if kind == "RawImage" else compressed("/image_raw", START_NS, buffer.getvalue(), frame="camera")
    said = [m for m in drive(1) if m.topic != "/image_raw"]
    path = write_bag(tmp_path, [*said, foxglove(one)], form)
    details = {topic.name: (topic.frame_id, topic.details) for topic in overview(Bag(path))}
    assert details["/image_raw"] == ("camera", "16x12 px rgb8" if kind == "RawImage" else "png")
    frame = dataset(path)[0]
    assert frame.name.endswith("/1700000000.000000000")
    assert np.array_equal(frame.image.rgb, pixels(0))
    assert np.allclose(frame.start, TRUTH)


@pytest.mark.parametrize("options", [[], ["--set", "data.image_topic=/image_raw"]])
def test_video_is_refused_with_advice(tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    said = [m for m in drive(1) if m.topic != "/image_raw"]
    video = foxglove(compressed("/image_raw", START_NS, b"\0\0\0\1", "h264"), "CompressedVideo")
    path = write_bag(tmp_path, [*said, video])
    assert main(["data", "check", f"ros:{path}", *options]) == 2
    message = capsys.readouterr().err
    assert "foxglove_msgs/CompressedVideo" in message
    assert "decode it to sensor_msgs/CompressedImage (ros2 run image_transport republish)" in message


def test_a_camera_that_differs_if_rectified_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rectified = np.array([18.0, 0, 6, 0, 0, 18, 4, 0, 0, 0, 1, 0])
    said = [m for m in drive(1) if m.topic != "/camera_info"]
    path = write_bag(tmp_path, [*said, camera_info("/camera_info", START_NS, CAMERA, p=rectified)])
    assert main(["data", "check", f"ros:{path}"]) == 0
    text = capsys.readouterr().out
    assert "K and D, for raw images, are used" in text
    assert "K has the centre (7, 5) px, focal length 20 px, P (6, 4) px, focal length 18 px" in text
    assert "--set data.rectified=true" in text
    for stated in (False, True):
        assert dataset(path, rectified=stated)[0].advice == ()
    assert dataset(path)[0].advice
    assert dataset(path)[0].warnings == ()


def in_view() -> Any:
    rng = np.random.default_rng(0)
    depth = rng.uniform(5, 20, 500)
    return np.column_stack([rng.uniform(-0.2, 0.2, 500) * depth, rng.uniform(-0.2, 0.2, 500) * depth, depth])


def rig() -> list[Said]:
    """Return a recording of two cameras, of which the right one is 10 ms late."""
    right_from_lidar = se3.exp(np.array([0, 0.5, 0, 0.2, 0, 0])) @ TRUTH
    said = [m for m in drive(info=False) if m.topic == "/points"]
    said.append(tf([transform("lidar", "left", se3.inverse(TRUTH))], START_NS))
    said.append(tf([transform("lidar", "right", se3.inverse(right_from_lidar))], START_NS))
    for side, later_ns in (("left", 0), ("right", 10_000_000)):
        said.append(camera_info(f"/rig/{side}/camera_info", START_NS, CAMERA))
        said += [
            image(f"/rig/{side}/image_raw", START_NS + i * 10**8 + later_ns, pixels(i), frame=side) for i in range(3)
        ]
    return sorted(said, key=lambda message: message.time_ns)


def test_several_cameras_of_a_bag_are_a_rig(tmp_path: Path) -> None:
    path = write_bag(tmp_path, rig())
    found = dataset(path, image_topic="/rig/left/image_raw, /rig/right/image_raw", every_s=0.2)
    assert found.names == (
        "drive/rig_left/1700000000.000000000",
        "drive/rig_left/1700000000.200000000",
        "drive/rig_right/1700000000.010000000",
        "drive/rig_right/1700000000.210000000",
    )
    assert [frame.camera_name for frame in found] == ["rig_left", "rig_left", "rig_right", "rig_right"]
    assert [frame.time_s for frame in found] == pytest.approx([0, 0.2, 0.01, 0.21])
    assert np.allclose(found[1].start, TRUTH)
    assert not np.allclose(found[3].start, TRUTH)
    assert np.array_equal(found[1].cloud.xyz, found[3].cloud.xyz)
    said = open_dataset(f"ros:{path}?image_topic=/rig/left/image_raw,/rig/right/image_raw", Registry.load())
    assert len(said.names) == 6
    one = dataset(path, image_topic="/rig/right/image_raw", camera_name="RIGHT")
    assert one.names[0] == "drive/1700000000.010000000"
    assert one[0].camera_name == "RIGHT"
    with refused(r"data\.camera_name applies to one camera"):
        dataset(path, image_topic="/rig/left/image_raw,/rig/right/image_raw", camera_name="RIGHT")


def test_the_dataset_keeps_the_contract_of_its_slot(tmp_path: Path) -> None:
    path = write_bag(tmp_path, drive(intensity=np.ones(200, np.float32), t=np.linspace(0, 1e8, 200).astype(np.uint32)))
    assert main(["plugin", "check", "ros", "--set", f"data.root={path}"]) == 0
