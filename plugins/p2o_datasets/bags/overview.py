"""Describe the topics of a bag, for users who select the topics of images and sweeps."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from p2o import InputError
from p2o_formats.frame_tree import bare

from p2o_datasets.bags import messages
from p2o_datasets.bags.bag import Bag, Message, Topic
from p2o_datasets.bags.choice import Chosen, choose
from p2o_datasets.bags.messages import read_header, read_message, shown
from p2o_datasets.bags.tf import read_frame_tree

_READ = (*messages.IMAGES, messages.CAMERA_INFO, *messages.CLOUDS, *messages.TF, *messages.PATHS)
_WINDOWS_S = (1, 10, 100)
_MAX_NAMED = 6


@dataclass(frozen=True)
class TopicOverview:
    """Description of a topic; times are the header stamps of its first and last message, else times of recording."""

    name: str
    type: str
    count: int
    rate_hz: float | None
    frame_id: str | None
    first_s: float | None
    last_s: float | None
    details: str


def overview(bag: Bag) -> list[TopicOverview]:
    """Return a description of each topic from its first and last message."""
    return [_topic(bag, topic) for topic in bag.topics.values()]


def chosen_words(bag: Bag) -> dict[str, str]:
    """Return the topics that the data set `ros` selects by default, or why the selection is ambiguous."""
    try:
        chosen = choose(bag)
    except InputError as problem:
        return {"ros": str(problem)}
    info = chosen.camera_info
    try:
        start = _start_words(bag, chosen)
    except InputError as problem:
        start = str(problem)
    return {
        "image": chosen.image.name,
        "cloud": chosen.cloud.name,
        "camera": info.name if info else "none: give a calibration file (--set data.camera=FILE)",
        "start": start,
    }


def _start_words(bag: Bag, chosen: Chosen) -> str:
    """Return whether TF connects the frames of the first image and the first sweep."""
    frames = []
    for topic in (chosen.image.name, chosen.cloud.name):
        message = bag.first(topic)
        header = read_header(message.topic.kind, message.data, ros1=message.ros1, where=f"{bag.path}: {topic}")
        frames.append(bare(header.frame_id))
    camera, lidar = frames
    tree = read_frame_tree(bag)
    if tree.pose(camera, lidar) is not None:
        return f"TF connects {lidar} and {camera}"
    names = f"; frames of TF: {', '.join(tree.names)} (data.cloud_frame, data.image_frame)" if tree.names else ""
    return f"none: no static transforms of TF connect {lidar} and {camera}{names}"


def _topic(bag: Bag, topic: Topic) -> TopicOverview:
    try:
        first = bag.first(topic.name) if topic.count else None
        last = _last(bag, topic, first)
        ends = [_times(message) for message in (first, last) if message is not None]
        frame_id, details = _details(first) if first is not None else (None, "")
    except InputError as problem:
        return TopicOverview(topic.name, shown(topic.kind), topic.count, None, None, None, None, str(problem))
    seconds = (ends[-1] - ends[0]) * 1e-9 if ends else 0.0
    rate_hz = round((topic.count - 1) / seconds, 3) if seconds > 0 else None
    first_s, last_s = (ends[0] * 1e-9, ends[-1] * 1e-9) if ends else (None, None)
    return TopicOverview(topic.name, shown(topic.kind), topic.count, rate_hz, frame_id, first_s, last_s, details)


def _last(bag: Bag, topic: Topic, first: Message | None) -> Message | None:
    """Return the last message, searched in growing windows from the end, so that long bags are not read completely."""
    if first is None or topic.count < 2:
        return first
    end_ns = bag.span_ns[1] + 1
    for window_s in (*_WINDOWS_S, None):
        start_ns = None if window_s is None else end_ns - window_s * 1_000_000_000
        last = deque(bag.messages([topic.name], start_ns), maxlen=1)
        if last:
            return last[0]
    return first


def _times(message: Message) -> int:
    header = getattr(_read(message), "header", None)
    return message.time_ns if header is None else int(header.stamp_ns)


def _read(message: Message) -> Any:
    kind = message.topic.kind
    if kind not in _READ:
        return None
    return read_message(kind, message.data, ros1=message.ros1, where=message.topic.name)


def _details(message: Message) -> tuple[str | None, str]:
    content, kind = _read(message), messages.FOXGLOVE.get(message.topic.kind, message.topic.kind)
    if content is None:
        return None, ""
    if kind in messages.TF:
        pairs = [f"{t.header.frame_id} > {t.child_frame_id}" for t in content]
        return None, ", ".join(pairs[:_MAX_NAMED]) + (", ..." if len(pairs) > _MAX_NAMED else "")
    header = content.header
    if kind == messages.IMAGE:
        text = f"{content.width}x{content.height} px {content.encoding}"
    elif kind == messages.COMPRESSED_IMAGE:
        text = content.format
    elif kind == messages.CAMERA_INFO:
        text = f"{content.width}x{content.height} px {content.distortion_model or 'no model'}"
        text += "" if content.K.any() else ", not calibrated"
    elif kind == messages.POINT_CLOUD:
        names = " ".join(field.name for field in content.fields)
        text = f"{content.width * content.height} points ({content.height} rows): {names}"
    elif kind in messages.LIVOX:
        text = f"{len(content.points)} points: {' '.join(content.points.dtype.names)}"
    else:
        text = f"child frame {content.child_frame_id}" if content.child_frame_id else ""
    return header.frame_id, text
