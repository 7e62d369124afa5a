"""A bag: its topics, and the bytes of its messages by time. The package `rosbags` knows the containers.

Bags come from outside. The library's way to types, which makes Python code of the definitions that a bag brings, is not
used; chunks are unpacked up to a bound; metadata.yaml is read by our own parser.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from heapq import merge
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from p2o.errors import InputError, MethodUnavailable, P2OError, UnknownNameError
from p2o.files.input_file import expanded, listing, read_start, read_text
from p2o.files.parsed_text import parse_yaml

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

MAX_UNPACKED_BYTES = 512 << 20
"""No recorder packs more into a chunk, and no message is larger."""
_METADATA = "metadata.yaml"
_SUFFIXES = (".bag", ".mcap", ".db3")
_FORMS = "a ROS 1 bag (.bag), a folder with metadata.yaml, or a file .db3 or .mcap"
_MCAP = b"\x89MCAP0\r\n"
_KINDS = {b"#ROSBAG ": ".bag", b"SQLite f": ".db3", _MCAP: ".mcap"}
_NEWEST_METADATA = 9


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, the type of its messages ("sensor_msgs/msg/Image"), and their number."""

    name: str
    kind: str
    count: int


@dataclass(frozen=True, eq=False)
class Message:
    """One message: its topic, when it was recorded (ns), and its bytes; `ros1` tells how they are packed."""

    topic: Topic
    time_ns: int
    data: bytes
    ros1: bool


class Bag:
    """A bag that is open; files are closed when nobody holds it any more. Copies in other processes open it anew.

    Raises InputError where the path is missing, no bag, damaged, cut off or of a kind that cannot be read, and
    MethodUnavailable where the package rosbags is not installed.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = expanded(path)
        files, self._packed = _files(self.path)
        kinds = {_kind(file) for file in files}
        self.ros1 = kinds == {".bag"}
        self._readers: list[Any] = []
        self._close = weakref.finalize(self, _close, self._readers)
        for file in files:
            with _reading(file):
                reader = _reader(file, _kind(file))
                reader.open()
                self._readers.append(reader)
                if self.ros1:
                    _bound_chunks(reader)
        self.topics = self._topics()
        """Topics by name, in the order of names."""

    def __reduce__(self) -> tuple[type[Bag], tuple[Path]]:
        return Bag, (self.path,)

    @property
    def name(self) -> str:
        """Name of the bag: that of its file or folder."""
        return self.path.resolve().stem

    @property
    def span_ns(self) -> tuple[int, int]:
        """When the first and the last message were recorded, in nanoseconds; (0, 0) for an empty bag."""
        about = [reader if self.ros1 else reader.metadata for reader in self._readers]
        spans = [(each.start_time, each.end_time) for each in about if each.end_time > each.start_time]
        return (min(start for start, _ in spans), max(end for _, end in spans) - 1) if spans else (0, 0)

    def topic(self, name: str) -> Topic:
        """Return the topic of a name; raises UnknownNameError with the nearest ones."""
        if name not in self.topics:
            raise UnknownNameError("topic", name, self.topics, where=self.path)
        return self.topics[name]

    def messages(
        self, topics: Iterable[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Message]:
        """Return the messages of topics in the order in which they were recorded, from `start_ns` to before `stop_ns`.

        Raises InputError where the bag turns out to be damaged.
        """
        wanted = set(topics)
        streams = [self._stream(reader, wanted, start_ns, stop_ns) for reader in self._readers]
        yield from streams[0] if len(streams) == 1 else merge(*streams, key=lambda message: message.time_ns)

    def first(self, topic: str) -> Message:
        """Return the first message of a topic; raises InputError where there is none, whatever the bag counts."""
        for message in self.messages([topic]):
            return message
        raise InputError(f"topic {topic} has no messages", where=self.path, expected="at least one")

    def message(self, topic: str, time_ns: int, number: int = 0) -> Message:
        """Return the message of a topic that was recorded at a time, the `number`-th of equal times.

        Raises InputError where there is none.
        """
        for found, message in enumerate(self.messages([topic], time_ns, time_ns + 1)):
            if found == number:
                return message
        raise InputError(f"the message of {topic} is gone", where=self.path, got=f"time {time_ns} ns")

    def _stream(self, reader: Any, wanted: set[str], start_ns: int | None, stop_ns: int | None) -> Iterator[Message]:
        connections = [c for c in reader.connections if c.topic in wanted]
        if not connections:
            return
        with _reading(self.path):
            for connection, time_ns, data in reader.messages(connections, start_ns, stop_ns):
                packed = self._packed and not self.ros1
                unpacked = _unpacked(_zstd().ZstdDecompressor(), data) if packed else data
                yield Message(self.topics[connection.topic], time_ns, unpacked, self.ros1)

    def _topics(self) -> Mapping[str, Topic]:
        connections: dict[str, list[Connection]] = {}
        for reader in self._readers:
            for connection in reader.connections:
                connections.setdefault(connection.topic, []).append(connection)
        found = {}
        for name in sorted(connections):
            kinds = sorted({connection.msgtype for connection in connections[name]})
            codings = {getattr(connection.ext, "serialization_format", "cdr") for connection in connections[name]}
            kind = kinds[0] if len(kinds) == 1 else "several types"
            if codings != {"cdr"}:
                kind = f"{kind} ({', '.join(sorted(map(str, codings)))})"
            found[name] = Topic(name, kind, sum(connection.msgcount for connection in connections[name]))
        return found


def _files(path: Path) -> tuple[list[Path], bool]:
    """Return the files of a bag in order, and whether each message is packed by zstd."""
    if not path.is_dir():
        return [path], False
    if not (path / _METADATA).exists():
        inside = [file.name for file in listing(path, "a bag") if file.suffix in _SUFFIXES]
        raise InputError(
            "the folder is no ROS 2 bag",
            where=path,
            expected=_METADATA,
            got=", ".join(inside[:5]) or "no bag in it",
            hint=f"name one of its files: {path / inside[0]}" if inside else None,
        )
    return _files_of_metadata(path)


def _files_of_metadata(folder: Path) -> tuple[list[Path], bool]:
    where = folder / _METADATA
    content = parse_yaml(read_text(where, "file of metadata"), "file of metadata", where)
    about = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    names = about.get("relative_file_paths") if isinstance(about, dict) else None
    if not isinstance(about, dict) or not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise InputError(
            "the file of metadata is that of no bag",
            where=where,
            expected="rosbag2_bagfile_information with relative_file_paths",
        )
    version = about.get("version")
    if not isinstance(version, int) or version > _NEWEST_METADATA:
        raise InputError(
            "the bag is of an unknown version", where=where, expected=f"1 to {_NEWEST_METADATA}", got=version
        )
    mode = str(about.get("compression_mode") or "none").lower()
    form = str(about.get("compression_format") or "none").lower()
    if mode == "file" or (mode not in ("none", "message")) or (mode == "message" and form != "zstd"):
        raise InputError(
            "the files of the bag are packed",
            where=where,
            expected="files that are not packed, or messages packed by zstd",
            got=f"compression_mode {mode}, compression_format {form}",
            hint="unpack them: ros2 bag convert, or zstd -d FILE.zstd and name the file itself",
        )
    # Some recorders write the folder's name before the file's. A link may lead to any file, but not be an odd one.
    files = [folder / PurePosixPath(name).name for name in names]
    if not files:
        raise InputError("the bag has no files", where=where, expected="relative_file_paths", got="an empty list")
    outside = next((file for file in files if not file.resolve().is_relative_to(folder.resolve())), None)
    if outside is not None:
        raise InputError("a file of the bag lies outside of its folder", where=where, got=outside.name)
    return files, mode == "message"


def _kind(file: Path) -> str:
    """Return which container a file is, as its usual suffix; raises InputError for all others."""
    start = read_start(file, "bag", 8)
    kind = _KINDS.get(start)
    if kind is None:
        raise InputError("this is no bag that p2o reads", where=file, expected=_FORMS, got=_looks_like(file, start))
    return kind


def _looks_like(file: Path, start: bytes) -> str:
    if start.startswith(b"\x28\xb5\x2f\xfd"):
        return "a file packed by zstd"
    return f"a file that begins with {start.hex(' ')}" if file.suffix in _SUFFIXES else f"a file '{file.name}'"


def _reader(file: Path, kind: str) -> Any:
    if kind == ".bag":
        from rosbags.rosbag1 import Reader

        return Reader(file)
    from rosbags.rosbag2 import storage_mcap, storage_sqlite3

    if kind == ".db3":
        return storage_sqlite3.Sqlite3Reader(file)
    # The library's own entries unpack whatever comes, however much it is.
    storage_mcap.DECOMPRESSORS.update(
        lz4=lambda data, size: _unpacked(_lz4(), data, size),
        zstd=lambda data, size: _unpacked(_zstd().ZstdDecompressor(), data, size),
    )
    return storage_mcap.McapReader(file)


def _bound_chunks(reader: Any) -> None:
    """Make a reader of ROS 1 bags unpack its chunks up to a bound."""
    import bz2

    from rosbags.rosbag1.reader import decompressors

    bounded: dict[Any, Callable[[bytes], bytes]] = {
        decompressors["none"]: lambda data: data,
        decompressors["bz2"]: lambda data: _unpacked(bz2.BZ2Decompressor(), data),
        decompressors["lz4"]: lambda data: _unpacked(_lz4(), data),
    }
    reader.chunks = {
        place: chunk._replace(decompressor=bounded[chunk.decompressor]) for place, chunk in reader.chunks.items()
    }


def _lz4() -> Any:
    from lz4.frame import LZ4FrameDecompressor

    return LZ4FrameDecompressor()


def _zstd() -> Any:
    from rosbags.rosbag2.storage_mcap import zstd

    return zstd


def _unpacked(decompressor: Any, data: bytes, size: int = MAX_UNPACKED_BYTES) -> bytes:
    if size > MAX_UNPACKED_BYTES:
        raise InputError("a chunk is too large", expected=f"at most {MAX_UNPACKED_BYTES} bytes", got=f"{size} bytes")
    unpacked: bytes = decompressor.decompress(data, max_length=size)
    if not decompressor.eof:
        # What ends at the bound may lack nothing but its end mark.
        unpacked += decompressor.decompress(b"", max_length=1) if len(unpacked) == size else b""
    if len(unpacked) > size or not decompressor.eof:
        raise InputError("a chunk is cut off or larger than it says", got=f"more than {len(unpacked)} bytes")
    return unpacked


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Raise InputError for whatever a reader meets in bytes that may say anything."""
    try:
        yield
    except GeneratorExit:
        raise
    except ModuleNotFoundError as problem:
        raise MethodUnavailable(
            f"bags are read by the package rosbags, which is not installed ({_package(problem)} is missing)",
            hint='run: pip install "rosbags>=0.11,<0.12"',
        ) from problem
    except P2OError as problem:
        if problem.where is not None or not isinstance(problem, InputError):
            raise
        raise InputError(problem.what, where=path, expected=problem.expected, got=problem.got) from problem
    except Exception as problem:
        said = f"{type(problem).__name__}: {problem}" if str(problem) else type(problem).__name__
        raise InputError("the bag cannot be read", where=path, got=said[:200], hint=_advice(said)) from problem


def _package(problem: ModuleNotFoundError) -> str:
    return (problem.name or "it").partition(".")[0]


def _advice(said: str) -> str:
    if "not ros2" in said:
        return "only MCAP of ROS 2 is read: convert others by their own tools"
    if "reindex" in said:
        return "the recording was not closed: rosbag reindex FILE"
    return "is it cut off? take it from its source again, or try rosbag reindex, ros2 bag reindex, or mcap recover"


def _close(readers: list[Any]) -> None:
    for reader in readers:
        with suppress(Exception):
            reader.close()
    readers.clear()
