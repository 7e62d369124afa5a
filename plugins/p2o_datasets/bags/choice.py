"""Select the topics of the image, the sweep and the camera in a bag: the named ones, else the only ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from p2o import InputError, UnknownNameError

from p2o_datasets.bags.bag import Bag, Topic
from p2o_datasets.bags.messages import CAMERA_INFO, CLOUDS, IMAGES, PATHS, TF, shown

_TRANSPORTS = ("/compressed", "/raw")
_VIDEOS = (
    "foxglove_msgs/msg/CompressedVideo", "foxglove.", "ffmpeg_image_transport_msgs/", "theora_image_transport/",
)  # fmt: skip
"""Types of images that are not decoded: video, and Foxglove's types that are not in the serialisation of ROS."""
DECODE = (
    "decode it to sensor_msgs/CompressedImage (ros2 run image_transport republish), or extract images with ffmpeg for "
    "the data set `folder`"
)
"""Advice for images that p2o does not decode, such as video."""


@dataclass(frozen=True)
class Chosen:
    """Topics of the frames; `camera_info` is None if the bag has no such topic."""

    image: Topic
    cloud: Topic
    camera_info: Topic | None


def choose(bag: Bag, image: str | None = None, cloud: str | None = None, camera_info: str | None = None) -> Chosen:
    """Return the topics with the given names, and the only topic of the type where no name is given.

    If an image is recorded both uncompressed and compressed, the uncompressed topic is used. The default camera of
    `NAME/image_raw` is `NAME/camera_info`.

    Raises UnknownNameError for an unknown topic, and InputError for a topic of another type, without a topic of the
    type, and for several topics.
    """
    images = [topic for topic in _of(bag, IMAGES) if not topic.name.endswith("/compressedDepth")]
    raw = {topic.name for topic in images}
    images = [topic for topic in images if base(topic.name) == topic.name or base(topic.name) not in raw]
    chosen = _one(bag, "image", image, IMAGES, images)
    swept = _one(bag, "cloud", cloud, CLOUDS, _of(bag, CLOUDS))
    return Chosen(chosen, swept, _camera_info(bag, chosen.name, camera_info))


def choose_path(bag: Bag, name: str | None = None) -> Topic | None:
    """Return the topic of the vehicle's poses, or None if there is none or more than one."""
    topics = _of(bag, PATHS)
    if name is not None:
        return _one(bag, "odometry", name, PATHS, topics)
    return topics[0] if len(topics) == 1 else None


def tf_topics(bag: Bag) -> tuple[list[str], list[str]]:
    """Return the topics of static transforms, and those of changing transforms."""
    names = [topic.name for topic in _of(bag, TF)]
    static = [name for name in names if name.endswith("tf_static")]
    return static, [name for name in names if name not in static]


def base(name: str) -> str:
    """Return the name of an image topic without its transport suffix."""
    return next((name.removesuffix(end) for end in _TRANSPORTS if name.endswith(end)), name)


def _camera_info(bag: Bag, image: str, name: str | None) -> Topic | None:
    topics = _of(bag, (CAMERA_INFO,))
    default = f"{base(image).rpartition('/')[0]}/camera_info"
    if name is None and bag.topics.get(default) in topics:
        return bag.topics[default]
    if name is None and not topics:
        return None
    return _one(bag, "camera_info", name, (CAMERA_INFO,), topics)


def _of(bag: Bag, kinds: Sequence[str]) -> list[Topic]:
    return [topic for topic in bag.topics.values() if topic.kind in kinds and topic.count]


def _one(bag: Bag, what: str, name: str | None, kinds: Sequence[str], candidates: Sequence[Topic]) -> Topic:
    wanted = " or ".join(shown(kind) for kind in kinds)
    if name is not None:
        if name not in bag.topics:
            known = [topic.name for topic in _of(bag, kinds)]
            raise UnknownNameError("topic", name, known or bag.topics, where=bag.path)
        topic = bag.topics[name]
        if topic.kind not in kinds or not topic.count:
            got = shown(topic.kind) if topic.kind not in kinds else "no messages"
            fault, hint = f"topic {name} is not a topic of type {what}", DECODE if _is_video(topic) else None
            raise InputError(fault, where=bag.path, expected=wanted, got=got, hint=hint)
        return topic
    if not candidates:
        available = ", ".join(f"{topic.name} ({shown(topic.kind)})" for topic in bag.topics.values())
        fault = f"the bag has no topic of a{'n' if what == 'image' else ''} {what}"
        hint = _of_packets(bag) if what == "cloud" else _of_video(bag) if what == "image" else None
        raise InputError(fault, where=bag.path, expected=wanted, got=available or "an empty bag", hint=hint)
    if len(candidates) > 1:
        fault, got = f"the bag has several topics of type {what}", ", ".join(topic.name for topic in candidates)
        hint = "for a rig, give several topics separated by commas" if what == "image" else None
        expected = f"one of them: --set data.{what}_topic=NAME"
        raise InputError(fault, where=bag.path, expected=expected, got=got, hint=hint)
    return candidates[0]


def _of_packets(bag: Bag) -> str | None:
    """Return a hint for bags with raw packets of a LiDAR, or None for other bags."""
    topics = bag.topics.values()
    packets = next((t for t in topics if "packet" in t.kind.lower() or t.kind.endswith("VelodyneScan")), None)
    driver = "play the bag through the driver of the LiDAR (velodyne_pointcloud and similar) and record PointCloud2"
    return None if packets is None else f"{packets.name} contains raw packets: {driver}"


def _is_video(topic: Topic) -> bool:
    return topic.kind.startswith(_VIDEOS)


def _of_video(bag: Bag) -> str | None:
    """Return a hint for bags with images in a form that p2o does not decode, or None for other bags."""
    video = next((topic for topic in bag.topics.values() if _is_video(topic)), None)
    return None if video is None else f"{video.name} contains {shown(video.kind)}: {DECODE}"
