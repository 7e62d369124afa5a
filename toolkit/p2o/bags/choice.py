"""Which topics of a bag are the image, the sweep and the camera: those that are named, else the only ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from p2o.bags.bag import Bag, Topic
from p2o.bags.messages import CAMERA_INFO, CLOUDS, IMAGES, PATHS, TF, shown
from p2o.errors import InputError, UnknownNameError

_TRANSPORTS = ("/compressed", "/raw")


@dataclass(frozen=True)
class Chosen:
    """Topics that frames are made of; `camera_info` is None in a bag without."""

    image: Topic
    cloud: Topic
    camera_info: Topic | None


def choose(bag: Bag, image: str | None = None, cloud: str | None = None, camera_info: str | None = None) -> Chosen:
    """Return the topics of the names that are given, and for the others the only one of their types.

    Of a picture that is recorded twice, as it is and compressed, the first is taken. The camera of `NAME/image_raw` is
    `NAME/camera_info` where it is there.

    Raises UnknownNameError for a topic that is not there, and InputError for one of another type, where there is none,
    and where several can be meant.
    """
    pictures = _of(bag, IMAGES)
    pictures = [
        topic
        for topic in pictures
        if not topic.name.endswith("/compressedDepth")
        and (base(topic.name) == topic.name or bag.topics.get(base(topic.name)) not in pictures)
    ]
    chosen = _one(bag, "image", image, IMAGES, pictures)
    return Chosen(
        chosen, _one(bag, "cloud", cloud, CLOUDS, _of(bag, CLOUDS)), _camera_info(bag, chosen.name, camera_info)
    )


def choose_path(bag: Bag, name: str | None = None) -> Topic | None:
    """Return the topic that tells the way of the vehicle, or None where nothing or more than one does."""
    found = _of(bag, PATHS)
    if name is not None:
        return _one(bag, "odometry", name, PATHS, found)
    return found[0] if len(found) == 1 else None


def tf_topics(bag: Bag) -> tuple[list[str], list[str]]:
    """Return the topics of transforms that never change, and those of others."""
    names = [topic.name for topic in _of(bag, TF)]
    static = [name for name in names if name.endswith("tf_static")]
    return static, [name for name in names if name not in static]


def base(name: str) -> str:
    """Return the name of an image topic without that of its transport."""
    return next((name.removesuffix(end) for end in _TRANSPORTS if name.endswith(end)), name)


def _camera_info(bag: Bag, image: str, name: str | None) -> Topic | None:
    found = _of(bag, (CAMERA_INFO,))
    beside = f"{base(image).rpartition('/')[0]}/camera_info"
    if name is None and bag.topics.get(beside) in found:
        return bag.topics[beside]
    if name is None and not found:
        return None
    return _one(bag, "camera_info", name, (CAMERA_INFO,), found)


def _of(bag: Bag, kinds: Sequence[str]) -> list[Topic]:
    return [topic for topic in bag.topics.values() if topic.kind in kinds and topic.count]


def _one(bag: Bag, what: str, name: str | None, kinds: Sequence[str], found: Sequence[Topic]) -> Topic:
    wanted = " or ".join(shown(kind) for kind in kinds)
    if name is not None:
        if name not in bag.topics:
            known = [topic.name for topic in _of(bag, kinds)]
            raise UnknownNameError("topic", name, known or bag.topics, where=bag.path)
        topic = bag.topics[name]
        if topic.kind not in kinds or not topic.count:
            got = shown(topic.kind) if topic.kind not in kinds else "no messages"
            raise InputError(f"topic {name} is no {what}", where=bag.path, expected=wanted, got=got)
        return topic
    if not found:
        there = ", ".join(f"{topic.name} ({shown(topic.kind)})" for topic in bag.topics.values())
        raise InputError(
            f"the bag has no topic of a{'n' if what == 'image' else ''} {what}",
            where=bag.path,
            expected=wanted,
            got=there or "an empty bag",
            hint=_of_packets(bag) if what == "cloud" else None,
        )
    if len(found) > 1:
        raise InputError(
            f"several topics can be the {what}",
            where=bag.path,
            expected=f"one of them: --set data.{what}_topic=NAME",
            got=", ".join(topic.name for topic in found),
            hint="several joined by commas are the cameras of a rig" if what == "image" else None,
        )
    return found[0]


def _of_packets(bag: Bag) -> str | None:
    """Return what to do with a bag of raw packets, or None where there are none."""
    packets = next(
        (t for t in bag.topics.values() if "packet" in t.kind.lower() or t.kind.endswith("VelodyneScan")), None
    )
    if packets is None:
        return None
    return (
        f"{packets.name} holds packets of the sensor: play the bag through its driver (velodyne_pointcloud and the "
        "like) and record the PointCloud2"
    )
