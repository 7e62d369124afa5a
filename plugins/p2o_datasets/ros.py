"""Read ROS bags: pairs of image and sweep by their stamps; ROS 1 (.bag), ROS 2 (.db3, .mcap, or their folder)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Dataset, Float, Frame, Image, InputError, Int, Method, Options, field, se3
from p2o.reading import LazyFrames, check_direction, layout, naming
from p2o_formats.frame_names import axes_remark, has_body_axes, optical_from
from p2o_formats.frame_tree import FrameTree, bare, optical_below

from p2o_datasets.bags.bag import SUFFIXES, Bag
from p2o_datasets.bags.choice import Chosen, base, choose, choose_path, tf_topics
from p2o_datasets.bags.messages import CAMERA_INFO, LIVOX, read_header, read_message
from p2o_datasets.bags.point_columns import columns_of
from p2o_datasets.bags.tf import read_frame_tree, read_transforms
from p2o_datasets.cloud_file import ReadPoints, read_points
from p2o_datasets.ego_path import nearest
from p2o_datasets.lazy_dataset import Words
from p2o_datasets.point_fields import PointClock, Unit
from p2o_datasets.ros_camera import RosCamera, camera_by_name, camera_of_file, camera_of_info
from p2o_datasets.ros_image import rgb_of

_SECOND = 1_000_000_000
_MAX_DISTANCE_M = 1e9


class RosOptions(Options):
    """Options of ROS bags."""

    root: Path = field(Path("."), help="A .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.")
    image_topic: Words = field(
        (), help="Topic of the images; default: the only one. Several, separated by commas, are the cameras of a rig."
    )
    cloud_topic: str | None = field(None, help="Topic of the sweeps (PointCloud2, Livox CustomMsg); null: the only one")
    camera_info_topic: str | None = field(None, help="Topic of CameraInfo; null: beside the image, or the only one.")
    camera: Path | None = field(None, help="Calibration file of the camera, of any format, instead of the CameraInfo.")
    rectified: bool | None = field(None, help="Whether P applies; null: if the topic's name contains `rect`.")
    tf: Literal["start", "truth", "ignore"] = field(
        "start", help="Use of the static transforms in TF: as initial guess (start), as ground truth, or not at all."
    )
    image_frame: str | None = field(None, help="Frame of the camera in TF; null: as in the images.")
    camera_axes: Literal["optical", "body"] | None = field(
        None, help="Axes of the camera's frame in TF: z forward (optical) or x forward (body); null: by its name."
    )
    cloud_frame: str | None = field(None, help="Frame of the sweeps in TF; null: as in the cloud messages.")
    stamps: Literal["header", "bag"] = field(
        "header", help="Time of a measurement: the stamp of the header, or the time of recording in the bag."
    )
    image_offset_s: float = field(0.0, ge=-1e6, le=1e6, help="Offset in seconds that is added to the image stamps.")
    max_gap_s: float = field(0.05, gt=0, le=10, help="Largest time difference in s of an image and its sweep.")
    point_times: Unit = field(
        "auto", help="Unit of the points' times; auto: the unit in which a sweep takes 4 to 400 ms; none: ignore them."
    )
    odometry_topic: str | None = field(None, help="Odometry or PoseStamped for `every_m`; null: the only one, else TF.")
    every_m: float | None = field(None, gt=0, le=1e6, help="Smallest distance between frames along the path, in m.")
    every_s: float | None = field(None, gt=0, le=1e6, help="Smallest time between frames, in s.")
    most: int | None = field(None, ge=1, help="Largest number of frames, spread evenly over the bag.")
    camera_name: str = field("", help="Name of the camera on its rig; several cameras are named by their topics.")


@dataclass(frozen=True)
class _MessageRef:
    """Time of recording, index among messages of that time, stamp, and stamp with `image_offset_s` (ns)."""

    time_ns: int
    number: int
    stamp_ns: int
    taken_ns: int
    frame_id: str


@dataclass(frozen=True, eq=False)
class _Source:
    """Data that all frames of a camera share; `camera_name` is empty for a single camera without a name.

    `extrinsic` is camera_from_lidar (4, 4) of the optical frame in TF if it is known, and the warnings about it.
    """

    bag: Bag
    options: RosOptions
    chosen: Chosen
    camera: RosCamera
    camera_name: str
    extrinsic: tuple[Float | None, tuple[str, ...]]
    first_ns: int


def build(options: RosOptions) -> Dataset:
    """Return the pairs of an image and its nearest sweep; names are "bag/seconds.nanoseconds" of the image's stamp.

    With several cameras, names are "bag/camera/seconds.nanoseconds". Each image and each sweep of a camera belongs to
    at most one frame. Here only stamps are read; a frame reads its two messages. Images without a near sweep are listed
    in `skipped`.

    Raises InputError for bags that are missing, damaged or unsupported, for ambiguous topics, and without a camera or
    without pairs.
    """
    bag = Bag(options.root)
    cameras = _cameras(bag, options)
    cloud_topic = cameras[0].chosen.cloud.name
    topics = [*(camera.chosen.image.name for camera in cameras), cloud_topic]
    skipped: dict[str, str] = {}
    references = _index(bag, topics, options, skipped)
    clouds = references[cloud_topic]
    first_ns = min(references[topic][0].stamp_ns for topic in topics[:-1])
    position_at: Callable[[Int], Float] | None = None
    entries: dict[str, tuple[_Source, _MessageRef, _MessageRef]] = {}
    for number, camera in enumerate(cameras):
        images = references[camera.chosen.image.name]
        tree = _tree(bag, options, images[0].frame_id, clouds[0].frame_id)
        extrinsic = _extrinsic(tree, options, images[0].frame_id, clouds[0].frame_id, bag)
        if number == 0:
            position_at = _position_at(bag, options, tree, clouds[0].frame_id)
        source = replace(camera, extrinsic=extrinsic, first_ns=first_ns)
        pairs = _thinned(_pairs(images, clouds, source, skipped), position_at, options)
        entries |= {_name(source, image): (source, image, cloud) for image, cloud in pairs}
    return LazyFrames(entries, _read, skipped)


def _cameras(bag: Bag, options: RosOptions) -> list[_Source]:
    """Return the selected cameras, without the data that depend on stamps; raises InputError as `build`."""
    topics = tuple(dict.fromkeys(options.image_topic))
    if len(topics) > 1:
        for name in ("camera_info_topic", "camera", "image_frame", "camera_name"):
            if getattr(options, name):
                got = ", ".join(topics)
                raise InputError(f"data.{name} applies to one camera", expected="a single data.image_topic", got=got)
    cameras = []
    for topic in topics or (None,):
        chosen = choose(bag, topic, options.cloud_topic, options.camera_info_topic)
        # A camera of several has the name of its topic without the last part.
        parts = base(chosen.image.name).strip("/").split("/")
        name = "_".join(parts[:-1] or parts) if len(topics) > 1 else options.camera_name
        cameras.append(_Source(bag, options, chosen, _camera(bag, options, chosen), name, (None, ()), 0))
    names = [source.camera_name for source in cameras]
    if len(set(names)) < len(names):
        raise InputError("the topics of two cameras give the same name", where=bag.path, got=", ".join(names))
    return cameras


def _camera(bag: Bag, options: RosOptions, chosen: Chosen) -> RosCamera:
    if options.camera is not None:
        return camera_of_file(options.camera)
    topic = chosen.camera_info
    if topic is None:
        fault = "the bag has no CameraInfo"
        hint = "give a calibration file of any format (`p2o methods`): --set data.camera=FILE"
        raise InputError(fault, where=bag.path, expected="a topic of sensor_msgs/CameraInfo", hint=hint)
    message = bag.first(topic.name)
    where = Path(f"{bag.path}: {topic.name}")
    content = read_message(CAMERA_INFO, message.data, ros1=message.ros1, where=where)
    if options.rectified is not None:
        return camera_of_info(content, where, rectified=options.rectified)
    return camera_by_name(content, where, rectified="rect" in base(chosen.image.name).rpartition("/")[2])


def _index(
    bag: Bag, topics: Sequence[str], options: RosOptions, skipped: dict[str, str]
) -> dict[str, list[_MessageRef]]:
    """Return references to the messages of each topic by unique stamps; damaged ones are listed in `skipped`."""
    references: dict[str, dict[int, _MessageRef]] = {topic: {} for topic in topics}
    counts = dict.fromkeys(topics, 0)
    numbers: Counter[tuple[str, int]] = Counter()
    offset_ns = round(options.image_offset_s * _SECOND)
    for message in bag.messages(topics):
        topic = message.topic.name
        number = numbers[topic, message.time_ns]
        numbers[topic, message.time_ns] += 1
        try:
            header = read_header(message.topic.kind, message.data, ros1=message.ros1, where=f"{bag.path}: {topic}")
        except InputError as problem:
            skipped[f"{bag.name}{topic}/{_seconds(message.time_ns)}"] = str(problem)
            continue
        stamp_ns = header.stamp_ns if options.stamps == "header" else message.time_ns
        taken_ns = stamp_ns + (offset_ns if topic != topics[-1] else 0)
        reference = _MessageRef(message.time_ns, number, stamp_ns, taken_ns, header.frame_id)
        references[topic].setdefault(stamp_ns, reference)
        counts[topic] += 1
    for topic, by_stamp in references.items():
        if len(by_stamp) < 2 and counts[topic] != 1:
            fault = f"the messages of {topic} have no stamps"
            got = f"one time in all {counts[topic]}" if by_stamp else next(iter(skipped.values()), "no messages")
            hint = "use the times of recording: --set data.stamps=bag"
            raise InputError(fault, where=bag.path, expected="headers with different times", got=got, hint=hint)
    return {topic: [by_stamp[stamp] for stamp in sorted(by_stamp)] for topic, by_stamp in references.items()}


def _pairs(
    images: Sequence[_MessageRef], clouds: Sequence[_MessageRef], source: _Source, skipped: dict[str, str]
) -> list[tuple[_MessageRef, _MessageRef]]:
    """Return the pairs of images and sweeps that are mutual nearest neighbours in time."""
    options = source.options
    image_ns, cloud_ns = (np.array([reference.taken_ns for reference in refs], np.int64) for refs in (images, clouds))
    near, back = nearest(cloud_ns, image_ns), nearest(image_ns, cloud_ns)
    pairs = []
    for number, image in enumerate(images):
        cloud = clouds[near[number]]
        gap_s = abs(cloud.taken_ns - image.taken_ns) / _SECOND
        if gap_s > options.max_gap_s:
            fault = f"no sweep within {options.max_gap_s:g} s, the nearest is {gap_s:.3g} s away"
            skipped[_name(source, image)] = fault
        elif back[near[number]] == number:
            pairs.append((image, cloud))
    if not pairs:
        gap_s = float(np.abs(cloud_ns[near] - image_ns).min()) / _SECOND
        fault = f"no image of {source.chosen.image.name} has a sweep of the same time"
        expected = f"stamps within {options.max_gap_s:g} s of each other (data.max_gap_s)"
        hint = "different clocks? data.image_offset_s shifts images; data.stamps=bag uses recording times"
        raise InputError(fault, where=source.bag.path, expected=expected, got=f"{gap_s:.6g} s at least", hint=hint)
    return pairs


def _tree(bag: Bag, options: RosOptions, image_frame: str, cloud_frame: str) -> FrameTree:
    """Return the frame tree of the bag; the long topic /tf is read only if /tf_static is not sufficient."""
    if options.tf == "ignore" and options.every_m is None:
        return FrameTree()
    tree = read_frame_tree(bag)
    with naming(bag.path):
        joined = tree.pose(options.image_frame or image_frame, options.cloud_frame or cloud_frame) is not None
    return tree if joined and options.every_m is None else read_frame_tree(bag, moving=True)


def _extrinsic(
    tree: FrameTree, options: RosOptions, image_frame: str, cloud_frame: str, bag: Bag
) -> tuple[Float | None, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of the optical frame in TF if it is known, and warnings.

    Below a frame of the images that is a body frame by its name, the only optical frame is used.
    """
    if options.tf == "ignore":
        return None, ()
    named = ((options.image_frame, image_frame, "image_frame"), (options.cloud_frame, cloud_frame, "cloud_frame"))
    camera, lidar = (bare(own) if name is None else tree.known(name, f"data.{key}") for name, own, key in named)
    if not tree.names and options.image_frame is None and options.cloud_frame is None:
        return None, ()
    remarks: tuple[str, ...] = ()
    own_axes = options.image_frame is not None or options.camera_axes is not None or not has_body_axes(camera)
    if not own_axes and (optical := optical_below(tree, camera)) is not None:
        remarks = (f"{bag.name}: the images are in frame {camera}: its optical frame {optical} of TF is used",)
        camera = optical
    with naming(bag.path):
        posed = tree.transform(camera, lidar)
    if posed is None:
        if options.tf == "truth" or options.image_frame is not None or options.cloud_frame is not None:
            fault = f"no static transforms of TF connect {lidar} and {camera}"
            got = f"frames {', '.join(tree.names) or '(none)'}"
            hint = "give the frames: --set data.image_frame=NAME, data.cloud_frame=NAME; or --set data.tf=ignore"
            raise InputError(fault, where=bag.path, expected="/tf_static from one to the other", got=got, hint=hint)
        text = f"{bag.name}: no static transforms of TF connect {lidar} and {camera}: no initial guess; frames of TF: "
        advice = "choose with data.cloud_frame or data.image_frame, or give --start"
        return None, (f"{text}{', '.join(tree.names)}: {advice}",)
    pose, more = posed
    axes = options.camera_axes
    if has_body_axes(camera):
        more = (*more, *axes_remark(camera, axes, "--set data.camera_axes", bag.name))
    return optical_from(camera, axes)[0] @ pose, (*remarks, *more)


def _position_at(bag: Bag, options: RosOptions, tree: FrameTree, cloud_frame: str) -> Callable[[Int], Float] | None:
    """Return a function from times (N,) in ns to positions (N, 3) from odometry, else TF; None without `every_m`."""
    if options.every_m is None:
        return None
    topic = choose_path(bag, options.odometry_topic)
    if topic is not None:
        messages, where = bag.messages([topic.name]), f"{bag.path}: {topic.name}"
        poses = [read_message(topic.kind, each.data, ros1=each.ros1, where=where) for each in messages]
    else:
        moving = tree.moving_above(options.cloud_frame or cloud_frame)
        changing = read_transforms(bag, tf_topics(bag)[1]) if moving is not None else []
        poses = [transform for transform in changing if bare(transform.child_frame_id) == moving]
    if not poses:
        expected = "one topic of Odometry or PoseStamped (or data.odometry_topic), or TF of a frame above the LiDAR"
        hint = "select frames by time: --set data.every_s=SECONDS instead of every_m"
        raise InputError("the bag has no poses of the vehicle", where=bag.path, expected=expected, hint=hint)
    by_time = {pose.header.stamp_ns: pose.translation_m for pose in poses}
    times = np.array(sorted(by_time), np.int64)
    positions = np.array([by_time[time] for time in times.tolist()], np.float64)
    if not (np.abs(positions) <= _MAX_DISTANCE_M).all():
        expected = f"positions within {_MAX_DISTANCE_M:g} m of the origin"
        got = "NaN, infinite or larger values"
        raise InputError("the positions of the vehicle are implausible", where=bag.path, expected=expected, got=got)

    def position_at(wanted: Int) -> Float:
        # Subtract as integers first: nanoseconds since 1970 have more digits than a double.
        later, known = (wanted - times[0]).astype(np.float64), (times - times[0]).astype(np.float64)
        return np.stack([np.interp(later, known, column) for column in positions.T], axis=1)

    return position_at


def _thinned(
    pairs: Sequence[tuple[_MessageRef, _MessageRef]], position_at: Callable[[Int], Float] | None, options: RosOptions
) -> list[tuple[_MessageRef, _MessageRef]]:
    """Return the pairs with the distances in metres and seconds and the largest number that the options demand."""
    times = np.array([image.taken_ns for image, _ in pairs], np.int64)
    positions = position_at(times) if position_at is not None else None
    kept: list[int] = []
    for number in range(len(pairs)):
        last = kept[-1] if kept else number
        gaps = [(options.every_s, float(times[number] - times[last]) / _SECOND)]
        if positions is not None:
            gaps.append((options.every_m, float(np.linalg.norm(positions[number] - positions[last]))))
        if not kept or all(least is None or gap >= least * (1 - 1e-9) for least, gap in gaps):
            kept.append(number)
    if options.most is not None and len(kept) > options.most:
        spread = np.linspace(0, len(kept) - 1, options.most).round().astype(int)
        kept = [kept[index] for index in spread.tolist()]
    return [pairs[number] for number in kept]


def _read(entry: tuple[_Source, _MessageRef, _MessageRef]) -> Frame:
    source, image_ref, cloud_ref = entry
    bag, options = source.bag, source.options
    camera = source.camera.camera
    name = _name(source, image_ref)
    image_name, where = f"{name}{source.chosen.image.name}", f"{bag.path}: {source.chosen.image.name}"
    message = bag.message(source.chosen.image.name, image_ref.time_ns, image_ref.number)
    content = read_message(message.topic.kind, message.data, ros1=message.ros1, where=where)
    rgb, warnings = rgb_of(content, where, image_name, (camera.width, camera.height))
    image = Image(rgb, camera)
    cloud, cloud_warnings, unused = _cloud(source, image_ref, cloud_ref)
    pose, pose_warnings = source.extrinsic
    warnings += (*cloud_warnings, *source.camera.warnings, *pose_warnings)
    if pose is not None:
        pose = se3.make(source.camera.rotation) @ pose
        warnings += check_direction(cloud, camera, pose, name=f"TF ({options.tf})", where=bag.path)
    extrinsic: dict[str, Any] = {"camera_from_lidar" if options.tf == "truth" else "start": pose}
    drive: dict[str, Any] = {"sequence": bag.name, "camera_name": source.camera_name}
    drive["time_s"] = (image_ref.stamp_ns - source.first_ns) / _SECOND
    notes: dict[str, Any] = {"warnings": warnings, "advice": source.camera.advice, "unused_fields": unused}
    return Frame(name, image, cloud, **notes, **extrinsic, **drive)


def _cloud(source: _Source, image_ref: _MessageRef, cloud_ref: _MessageRef) -> ReadPoints:
    bag, topic = source.bag, source.chosen.cloud
    where = Path(f"{bag.path}: {topic.name}")
    message = bag.message(topic.name, cloud_ref.time_ns, cloud_ref.number)
    unit = source.options.point_times
    # The unit of Livox is known, also for clouds of too few points to infer it.
    known: Unit = "ns" if topic.kind in LIVOX and unit == "auto" else unit
    clock = PointClock(known, image_ref.taken_ns, cloud_ref.taken_ns, setting="--set data.point_times=")
    with naming(where):
        columns = columns_of(read_message(topic.kind, message.data, ros1=message.ros1))
    return read_points(columns, where, clock)


def _name(source: _Source, image: _MessageRef) -> str:
    camera = f"{source.camera_name}/" if len(source.options.image_topic) > 1 else ""
    return f"{source.bag.name}/{camera}{_seconds(image.stamp_ns)}"


def _seconds(time_ns: int) -> str:
    return f"{time_ns // _SECOND}.{time_ns % _SECOND:09d}"


def recognises(path: Path) -> bool:
    """Return whether a path is a bag or a folder of bags."""
    return path.suffix in SUFFIXES if path.is_file() else layout(*(f"*{suffix}" for suffix in SUFFIXES))(path)


METHOD = Method(
    name="ros",
    build=build,
    options=RosOptions,
    summary="ROS 1 and 2 bags and MCAP: images and sweeps paired by time, camera of CameraInfo, initial guess of TF.",
    gives=frozenset({"rings", "intensity", "time"}),
    extra="ros",
    recognises=recognises,
)
