"""ROS bags: pairs of an image and a sweep, by their stamps; ROS 1 (.bag), ROS 2 (.db3, .mcap, or their folder)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from p2o import Cloud, Dataset, Frame, Image, InputError, Method, Options, field, se3
from p2o.arrays import Float, Int
from p2o.bags.bag import Bag
from p2o.bags.choice import Chosen, base, choose, choose_path, tf_topics
from p2o.bags.frame_tree import FrameTree, bare, read_frame_tree, read_transforms
from p2o.bags.messages import CAMERA_INFO, LIVOX, read_header, read_message
from p2o.bags.point_columns import Unit, columns_of, named_columns, seconds_after, usable_points
from p2o.files.input_file import naming
from p2o.frames.direction import check_direction

from p2o_plugins.data.cloud_file import cloud_from_fields
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.name_choice import Words
from p2o_plugins.data.ros_camera import RosCamera, camera_of_file, camera_of_info
from p2o_plugins.data.ros_image import rgb_of
from p2o_plugins.data.time_pairs import nearest

_SECOND = 1_000_000_000
_FARTHEST_M = 1e9


class RosOptions(Options):
    """Options of ROS bags."""

    root: Path = field(Path("."), help="A .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.")
    image_topic: Words = field(
        (), help="Topic of the images; none: the only one. Several, joined by commas, are the cameras of a rig."
    )
    cloud_topic: str | None = field(
        None, help="Topic of the sweeps (PointCloud2 or Livox CustomMsg); null: the only one."
    )
    camera_info_topic: str | None = field(
        None, help="Topic of the CameraInfo; null: camera_info beside the image, else the only one."
    )
    camera: Path | None = field(
        None, help="Calibration file with the camera, of any form, where the bag has no CameraInfo or a wrong one."
    )
    rectified: bool | None = field(
        None, help="Whether the images are rectified, so that P is their camera; null: as the topic says (`rect`)."
    )
    tf: Literal["start", "truth", "ignore"] = field(
        "start", help="What the fixed transforms of the bag are: the start, the truth, or nothing."
    )
    image_frame: str | None = field(
        None, help="Optical frame of the camera in TF (z forward, y down); null: as the images say."
    )
    cloud_frame: str | None = field(None, help="Frame of the sweeps in TF; null: as the sweeps say.")
    stamps: Literal["header", "bag"] = field(
        "header", help="When a message was measured: the stamp of its header, or when it was recorded."
    )
    image_offset_s: float = field(0.0, ge=-1e6, le=1e6, help="Added to the stamps of the images, in seconds.")
    max_gap_s: float = field(0.05, gt=0, le=10, help="Largest difference of the stamps of an image and its sweep.")
    point_times: Unit = field(
        "auto", help="Unit of the points' times; auto: what fits a sweep of 4 to 400 ms; none: they are left out."
    )
    odometry_topic: str | None = field(
        None, help="Topic of Odometry or PoseStamped for `every_m`; null: the only one, else TF."
    )
    every_m: float | None = field(None, gt=0, le=1e6, help="Take a frame each so many metres of the way.")
    every_s: float | None = field(None, gt=0, le=1e6, help="Take a frame each so many seconds.")
    most: int | None = field(None, ge=1, help="Take at most so many frames, spread over the bag.")
    camera_name: str = field(
        "", help="Word for the camera on its rig, such as CAM_FRONT; several cameras are named by their topics."
    )


@dataclass(frozen=True)
class _Place:
    """Where a message is: when it was recorded, and which of those of that time; when it was measured, and its frame.

    Times are in ns; `stamp_ns` is as the bag says it, `taken_ns` corrected by `image_offset_s`.
    """

    time_ns: int
    number: int
    stamp_ns: int
    taken_ns: int
    frame_id: str


@dataclass(frozen=True, eq=False)
class _Extrinsic:
    """camera_from_lidar (4, 4) of the optical frame in TF where it is known, and a warning where it is not."""

    pose: Float | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Source:
    """What all frames of one camera have in common; `camera_name` is empty where there is one camera without a name."""

    bag: Bag
    options: RosOptions
    chosen: Chosen
    camera: RosCamera
    camera_name: str
    extrinsic: _Extrinsic
    first_ns: int


def build(options: RosOptions) -> Dataset:
    """Return the pairs of an image and the sweep that is nearest to it; names are "bag/seconds.nanoseconds".

    Seconds are those of the image's stamp; with several cameras names are "bag/camera/seconds.nanoseconds". Each image
    and each sweep of a camera is of one frame at most. Only stamps are read here; a frame reads its two messages.
    Images without a sweep near them are listed in `skipped`.

    Raises InputError where the bag is missing, damaged or of another kind, topics cannot be told, there is no camera,
    or no image has a sweep.
    """
    bag = Bag(options.root)
    cameras = _cameras(bag, options)
    cloud_topic = cameras[0].chosen.cloud.name
    topics = [*(camera.chosen.image.name for camera in cameras), cloud_topic]
    skipped: dict[str, str] = {}
    places = _index(bag, topics, options, skipped)
    clouds = places[cloud_topic]
    first_ns = min(places[topic][0].stamp_ns for topic in topics[:-1])
    way: Callable[[Int], Float] | None = None
    entries: dict[str, tuple[_Source, _Place, _Place]] = {}
    for number, camera in enumerate(cameras):
        images = places[camera.chosen.image.name]
        tree = _tree(bag, options, images[0].frame_id, clouds[0].frame_id)
        extrinsic = _extrinsic(tree, options, images[0].frame_id, clouds[0].frame_id, bag)
        if number == 0:
            way = _way(bag, options, tree, clouds[0].frame_id)
        source = replace(camera, extrinsic=extrinsic, first_ns=first_ns)
        pairs = _pairs(images, clouds, source, skipped)
        entries |= {_name(source, image): (source, image, cloud) for image, cloud in _thinned(pairs, way, options)}
    return LazyFrames(entries, _read, skipped)


def _cameras(bag: Bag, options: RosOptions) -> list[_Source]:
    """Return the chosen cameras, without what the stamps tell; raises InputError as `build`."""
    topics = tuple(dict.fromkeys(options.image_topic))
    if len(topics) > 1:
        for name in ("camera_info_topic", "camera", "image_frame", "camera_name"):
            if getattr(options, name):
                raise InputError(
                    f"data.{name} is of one camera", expected="one data.image_topic beside it", got=", ".join(topics)
                )
    found = []
    for topic in topics or (None,):
        chosen = choose(bag, topic, options.cloud_topic, options.camera_info_topic)
        name = _camera_name(chosen.image.name) if len(topics) > 1 else options.camera_name
        found.append(_Source(bag, options, chosen, _camera(bag, options, chosen), name, _Extrinsic(), 0))
    names = [source.camera_name for source in found]
    if len(set(names)) < len(names):
        raise InputError("the topics of two cameras have one name", where=bag.path, got=", ".join(names))
    return found


def _camera_name(topic: str) -> str:
    """Return the name of a camera: its topic but for the last part."""
    above = base(topic).strip("/").rpartition("/")[0] or base(topic).strip("/")
    return above.replace("/", "_")


def _camera(bag: Bag, options: RosOptions, chosen: Chosen) -> RosCamera:
    if options.camera is not None:
        return camera_of_file(options.camera)
    topic = chosen.camera_info
    if topic is None:
        raise InputError(
            "the bag has no CameraInfo",
            where=bag.path,
            expected="a topic of sensor_msgs/CameraInfo",
            hint="name a YAML file with the camera: --set data.camera=FILE",
        )
    message = bag.first(topic.name)
    where = Path(f"{bag.path}: {topic.name}")
    content = read_message(CAMERA_INFO, message.data, ros1=message.ros1, where=where)
    rectified = options.rectified
    if rectified is None:
        rectified = "rect" in base(chosen.image.name).rpartition("/")[2]
    return camera_of_info(content, where, rectified=rectified)


def _index(bag: Bag, topics: Sequence[str], options: RosOptions, skipped: dict[str, str]) -> dict[str, list[_Place]]:
    """Return where the images and, the last topic, the sweeps are, in the order of their stamps; equal ones count once.

    Messages whose header cannot be read are noted in `skipped`. Raises InputError where no stamps tell them apart.
    """
    found: dict[str, dict[int, _Place]] = {topic: {} for topic in topics}
    counts = dict.fromkeys(topics, 0)
    before: dict[str, tuple[int, int]] = {}
    offset_ns = round(options.image_offset_s * _SECOND)
    for message in bag.messages(topics):
        topic = message.topic.name
        time_ns, number = before.get(topic, (-1, -1))
        number = number + 1 if time_ns == message.time_ns else 0
        before[topic] = (message.time_ns, number)
        try:
            header = read_header(message.data, ros1=message.ros1, where=f"{bag.path}: {topic}")
        except InputError as problem:
            skipped[f"{bag.name}{topic}/{_seconds(message.time_ns)}"] = str(problem)
            continue
        stamp_ns = header.stamp_ns if options.stamps == "header" else message.time_ns
        taken_ns = stamp_ns + (offset_ns if topic != topics[-1] else 0)
        found[topic].setdefault(stamp_ns, _Place(message.time_ns, number, stamp_ns, taken_ns, header.frame_id))
        counts[topic] += 1
    for topic, places in found.items():
        if len(places) < 2 and counts[topic] != 1:
            raise InputError(
                f"the messages of {topic} have no stamps",
                where=bag.path,
                expected="headers with times that differ",
                got=f"the same time in all {counts[topic]}" if places else next(iter(skipped.values()), "no messages"),
                hint="take the times of recording: --set data.stamps=bag",
            )
    return {topic: [places[stamp] for stamp in sorted(places)] for topic, places in found.items()}


def _pairs(
    images: Sequence[_Place], clouds: Sequence[_Place], source: _Source, skipped: dict[str, str]
) -> list[tuple[_Place, _Place]]:
    """Return images and sweeps of which each is the nearest of the other, in time."""
    options = source.options
    image_ns, cloud_ns = (np.array([place.taken_ns for place in places], np.int64) for places in (images, clouds))
    near, back = nearest(cloud_ns, image_ns), nearest(image_ns, cloud_ns)
    pairs = []
    for number, image in enumerate(images):
        cloud = clouds[near[number]]
        gap_s = abs(cloud.taken_ns - image.taken_ns) / _SECOND
        if gap_s > options.max_gap_s:
            skipped[_name(source, image)] = (
                f"no sweep within {options.max_gap_s:g} s, the nearest is {gap_s:.3g} s away"
            )
        elif back[near[number]] == number:
            pairs.append((image, cloud))
    if not pairs:
        gap_s = float(np.abs(cloud_ns[near] - image_ns).min()) / _SECOND
        raise InputError(
            f"no image of {source.chosen.image.name} has a sweep of its time",
            where=source.bag.path,
            expected=f"stamps within {options.max_gap_s:g} s of each other (data.max_gap_s)",
            got=f"{gap_s:.6g} s at least",
            hint="are they of two clocks? data.image_offset_s shifts them, data.stamps=bag takes times of recording",
        )
    return pairs


def _tree(bag: Bag, options: RosOptions, image_frame: str, cloud_frame: str) -> FrameTree:
    """Return the frames of the bag; /tf, which is long, is read only where /tf_static does not tell enough."""
    if options.tf == "ignore" and options.every_m is None:
        return FrameTree({})
    tree = read_frame_tree(bag)
    with naming(bag.path):
        joined = tree.pose(options.image_frame or image_frame, options.cloud_frame or cloud_frame) is not None
    return tree if joined and options.every_m is None else read_frame_tree(bag, moving=True)


def _extrinsic(tree: FrameTree, options: RosOptions, image_frame: str, cloud_frame: str, bag: Bag) -> _Extrinsic:
    if options.tf == "ignore":
        return _Extrinsic()
    camera, lidar = (
        bare(found) if named is None else tree.known(named, f"data.{option}")
        for option, named, found in (
            ("image_frame", options.image_frame, image_frame),
            ("cloud_frame", options.cloud_frame, cloud_frame),
        )
    )
    if not tree.names and options.image_frame is None and options.cloud_frame is None:
        return _Extrinsic()
    with naming(bag.path):
        pose = tree.pose(camera, lidar)
    if pose is None:
        if options.tf == "truth" or options.image_frame is not None or options.cloud_frame is not None:
            raise InputError(
                f"no fixed transforms of TF join {lidar} and {camera}",
                where=bag.path,
                expected="/tf_static from one to the other",
                got=f"frames {', '.join(tree.names) or '(none)'}",
                hint="name frames: --set data.image_frame=NAME, data.cloud_frame=NAME; or --set data.tf=ignore",
            )
        return _Extrinsic(None, (f"{bag.name}: no fixed transforms of TF join {lidar} and {camera}: no start",))
    return _Extrinsic(pose)


def _way(bag: Bag, options: RosOptions, tree: FrameTree, cloud_frame: str) -> Callable[[Int], Float] | None:
    """Return what tells places (N, 3) at times (N,) in ns from odometry, else from TF; None where no place is asked."""
    if options.every_m is None:
        return None
    topic = choose_path(bag, options.odometry_topic)
    if topic is not None:
        poses = [
            read_message(topic.kind, message.data, ros1=message.ros1, where=f"{bag.path}: {topic.name}")
            for message in bag.messages([topic.name])
        ]
    else:
        moving = tree.moving_above(options.cloud_frame or cloud_frame)
        changing = read_transforms(bag, tf_topics(bag)[1]) if moving is not None else []
        poses = [transform for transform in changing if bare(transform.child_frame_id) == moving]
    if not poses:
        raise InputError(
            "nothing in the bag tells the way of the vehicle",
            where=bag.path,
            expected="one topic of Odometry or PoseStamped (or data.odometry_topic), or TF of a frame above the LiDAR",
            hint="choose frames by time: --set data.every_s=SECONDS instead of every_m",
        )
    at = {pose.header.stamp_ns: pose.translation_m for pose in poses}
    times = np.array(sorted(at), np.int64)
    places = np.array([at[time] for time in times.tolist()], np.float64)
    if not (np.abs(places) <= _FARTHEST_M).all():
        raise InputError(
            "the way of the vehicle leaves all maps",
            where=bag.path,
            expected=f"places within {_FARTHEST_M:g} m of the origin",
            got="NaN, infinite or larger ones",
        )

    def at_times(wanted: Int) -> Float:
        # Differences first: nanoseconds since 1970 have more digits than a double.
        later, known = (wanted - times[0]).astype(np.float64), (times - times[0]).astype(np.float64)
        return np.stack([np.interp(later, known, column) for column in places.T], axis=1)

    return at_times


def _thinned(
    pairs: Sequence[tuple[_Place, _Place]], way: Callable[[Int], Float] | None, options: RosOptions
) -> list[tuple[_Place, _Place]]:
    """Return the pairs that lie so far apart as the options say, in metres and in seconds, and at most so many."""
    times = np.array([image.taken_ns for image, _ in pairs], np.int64)
    places = way(times) if way is not None else None
    kept: list[int] = []
    for number in range(len(pairs)):
        if kept:
            seconds = float(times[number] - times[kept[-1]]) / _SECOND
            if options.every_s is not None and seconds < options.every_s * (1 - 1e-9):
                continue
            if places is not None and options.every_m is not None:
                gone_m = float(np.linalg.norm(places[number] - places[kept[-1]]))
                if gone_m < options.every_m * (1 - 1e-9):
                    continue
        kept.append(number)
    if options.most is not None and len(kept) > options.most:
        spread = np.linspace(0, len(kept) - 1, options.most).round().astype(int)
        kept = [kept[index] for index in spread.tolist()]
    return [pairs[number] for number in kept]


def _read(entry: tuple[_Source, _Place, _Place]) -> Frame:
    source, image_place, cloud_place = entry
    bag, options = source.bag, source.options
    camera = source.camera.camera
    name = _name(source, image_place)
    image_name, where = f"{name}{source.chosen.image.name}", f"{bag.path}: {source.chosen.image.name}"
    message = bag.message(source.chosen.image.name, image_place.time_ns, image_place.number)
    picture = read_message(message.topic.kind, message.data, ros1=message.ros1, where=where)
    rgb, warnings = rgb_of(picture, where, image_name, (camera.width, camera.height))
    image = Image(rgb, camera)
    cloud, cloud_warnings = _cloud(source, image_place, cloud_place)
    warnings += (*cloud_warnings, *source.camera.warnings, *source.extrinsic.warnings)
    pose = source.extrinsic.pose
    if pose is not None:
        pose = se3.make(source.camera.rotation) @ pose
        warnings += check_direction(cloud, camera, pose, name=f"TF ({options.tf})", where=bag.path)
    return Frame(
        name,
        image,
        cloud,
        camera_from_lidar=pose if options.tf == "truth" else None,
        start=pose if options.tf == "start" else None,
        warnings=warnings,
        sequence=bag.name,
        time_s=(image_place.stamp_ns - source.first_ns) / _SECOND,
        camera_name=source.camera_name,
    )


def _cloud(source: _Source, image_place: _Place, place: _Place) -> tuple[Cloud, tuple[str, ...]]:
    bag, topic = source.bag, source.chosen.cloud
    where = Path(f"{bag.path}: {topic.name}")
    message = bag.message(topic.name, place.time_ns, place.number)
    unit = source.options.point_times
    with naming(where):
        content = read_message(topic.kind, message.data, ros1=message.ros1)
        columns = named_columns(columns_of(content))
        times = columns.pop("time", None)
        remark = None
        if times is not None and set("xyz") <= set(columns):
            # Livox says its unit; so that a cloud of a few points is read, too.
            known: Unit = "ns" if topic.kind in LIVOX and unit == "auto" else unit
            usable = usable_points(columns)
            time_s, remark = seconds_after(times, usable, place.taken_ns, image_place.taken_ns, known)
            if time_s is not None:
                columns["time_s"] = time_s
    cloud, warnings = cloud_from_fields(columns, where)
    return cloud, (*warnings, *((f"{where.name}: {remark}",) if remark else ()))


def _name(source: _Source, image: _Place) -> str:
    camera = f"{source.camera_name}/" if len(source.options.image_topic) > 1 else ""
    return f"{source.bag.name}/{camera}{_seconds(image.stamp_ns)}"


def _seconds(time_ns: int) -> str:
    return f"{time_ns // _SECOND}.{time_ns % _SECOND:09d}"


METHOD = Method(
    name="ros",
    build=build,
    options=RosOptions,
    summary="ROS 1 and 2 bags and MCAP: images and sweeps paired by time, cameras of CameraInfo, starts of TF.",
    gives=frozenset({"rings", "intensity", "time"}),
    extra="ros",
)
