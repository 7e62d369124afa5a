"""Read a bag: its topics, and the bytes of its messages in temporal order; `rosbags` decodes the containers.

Bags are untrusted input: the function of `rosbags` that generates Python code from the message definitions in a bag is
not used, chunks are decompressed up to a bound, and metadata.yaml is read with p2o's safe YAML parser.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from heapq import merge
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from p2o import InputError, MethodUnavailable, P2OError
from p2o.reading import expanded, listing, parse_yaml, read_start, read_text

from p2o_datasets.bags.bag_guard import check_chunks, check_sqlite, escaped, limit_steps, limited_connections
from p2o_datasets.lazy_dataset import file_inside

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

MAX_UNPACKED_BYTES = 512 << 20
"""Upper bound for decompressed chunks and messages."""
_UNPACKED_BYTES, _MAX_RATIO = 64 << 20, 200
"""Data larger than `_UNPACKED_BYTES` have to be plausible: real images and points are compressed by 2 to 20."""
_METADATA = "metadata.yaml"
SUFFIXES = (".bag", ".mcap", ".db3")
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
    """A message: its topic, its time of recording in ns, its bytes, and whether they are in ROS 1 serialisation."""

    topic: Topic
    time_ns: int
    data: bytes
    ros1: bool


class Bag:
    """An open bag; its files are closed when the object is deleted. A copy in another process opens them again.

    Raises InputError for bags that are missing, damaged, truncated or of an unsupported kind, and MethodUnavailable if
    rosbags is not installed.
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
                self._readers.append(reader := _opened(file, kind := _kind(file)))
                if kind == ".bag":
                    _bound_chunks(reader)
                elif kind == ".mcap":
                    check_chunks(reader, file)
        self.topics = self._topics()
        """Topics by name, sorted."""

    def __reduce__(self) -> tuple[type[Bag], tuple[Path]]:
        return Bag, (self.path,)

    @property
    def name(self) -> str:
        """Name of the bag's file or folder."""
        return self.path.resolve().stem

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of recording of the first and the last message in nanoseconds; (0, 0) for an empty bag."""
        about = [reader if self.ros1 else reader.metadata for reader in self._readers]
        spans = [(each.start_time, each.end_time) for each in about if each.end_time > each.start_time]
        return (min(start for start, _ in spans), max(end for _, end in spans) - 1) if spans else (0, 0)

    def messages(
        self, topics: Iterable[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Message]:
        """Yield the messages of topics in the order of recording, from `start_ns` until before `stop_ns`.

        Raises InputError if the bag is damaged.
        """
        wanted = set(topics)
        streams = [self._stream(reader, wanted, start_ns, stop_ns) for reader in self._readers]
        yield from streams[0] if len(streams) == 1 else merge(*streams, key=lambda message: message.time_ns)

    def first(self, topic: str) -> Message:
        """Return the first message of a topic; raises InputError if there is none."""
        for message in self.messages([topic]):
            return message
        raise InputError(f"topic {topic} has no messages", where=self.path, expected="at least one")

    def message(self, topic: str, time_ns: int, number: int = 0) -> Message:
        """Return the message of a topic that was recorded at a time, the `number`-th of equal times.

        Raises InputError if there is none.
        """
        for index, message in enumerate(self.messages([topic], time_ns, time_ns + 1)):
            if index == number:
                return message
        raise InputError(f"the message of {topic} no longer exists", where=self.path, got=f"time {time_ns} ns")

    def _stream(self, reader: Any, wanted: set[str], start_ns: int | None, stop_ns: int | None) -> Iterator[Message]:
        connections = [c for c in reader.connections if c.topic in wanted]
        if not connections:
            return
        with _reading(self.path):
            if getattr(reader, "dbconn", None) is not None:
                limit_steps(reader.dbconn, Path(unquote(str(reader.path))))
            for connection, time_ns, data in reader.messages(connections, start_ns, stop_ns):
                if not isinstance(time_ns, int) or not isinstance(data, bytes):
                    got = f"{type(time_ns).__name__} and {type(data).__name__}"
                    raise InputError("a message has another type", expected="a time and bytes", got=got)
                packed = self._packed and not self.ros1
                unpacked = _unpacked(_zstd().ZstdDecompressor(), data) if packed else data
                yield Message(self.topics[connection.topic], time_ns, unpacked, self.ros1)

    def _topics(self) -> Mapping[str, Topic]:
        connections: dict[str, list[Connection]] = {}
        for reader in self._readers:
            for connection in reader.connections:
                connections.setdefault(connection.topic, []).append(connection)
        topics = {}
        for name in sorted(connections):
            kinds = sorted({connection.msgtype for connection in connections[name]})
            codings = {getattr(connection.ext, "serialization_format", "cdr") for connection in connections[name]}
            kind = kinds[0] if len(kinds) == 1 else "several types"
            if codings != {"cdr"}:
                kind = f"{kind} ({', '.join(sorted(map(str, codings)))})"
            topics[name] = Topic(name, kind, sum(connection.msgcount for connection in connections[name]))
        return topics


def _files(path: Path) -> tuple[list[Path], bool]:
    """Return the files of a bag in order, and whether each message is compressed with zstd."""
    if not path.is_dir():
        return [path], False
    if not (path / _METADATA).exists():
        inside = [file.name for file in listing(path, "a bag") if file.suffix in SUFFIXES]
        fault = "the folder is not a ROS 2 bag"
        hint = f"give one of its files: {path / inside[0]}" if inside else None
        raise InputError(fault, where=path, expected=_METADATA, got=", ".join(inside[:5]) or "no bag in it", hint=hint)
    where = path / _METADATA
    content = parse_yaml(read_text(where, "file of metadata"), "file of metadata", where)
    about = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    names = about.get("relative_file_paths") if isinstance(about, dict) else None
    if not isinstance(about, dict) or not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        fault = "the file of metadata does not describe a bag"
        raise InputError(fault, where=where, expected="rosbag2_bagfile_information with relative_file_paths")
    version = about.get("version")
    if not isinstance(version, int) or version > _NEWEST_METADATA:
        expected = f"1 to {_NEWEST_METADATA}"
        raise InputError("the bag has an unsupported version", where=where, expected=expected, got=version)
    mode = str(about.get("compression_mode") or "none").lower()
    form = str(about.get("compression_format") or "none").lower()
    if mode == "file" or (mode not in ("none", "message")) or (mode == "message" and form != "zstd"):
        expected = "uncompressed files, or messages compressed with zstd"
        got = f"compression_mode {mode}, compression_format {form}"
        hint = "decompress them: ros2 bag convert, or zstd -d FILE.zstd and give the file itself"
        raise InputError("the files of the bag are compressed", where=where, expected=expected, got=got, hint=hint)
    # Some recorders write the name of the folder before that of the file. Links out of the folder are refused.
    if not names:
        raise InputError("the bag has no files", where=where, expected="relative_file_paths", got="an empty list")
    files = [file_inside(path.resolve(), path, PurePosixPath(name).name, where) for name in names]
    return files, mode == "message"


def _kind(file: Path) -> str:
    """Return the container of a file as its usual suffix; raises InputError for other files."""
    start = read_start(file, "bag", 8)
    if start in _KINDS:
        return _KINDS[start]
    got = f"a file that starts with {start.hex(' ')}" if file.suffix in SUFFIXES else f"a file '{file.name}'"
    if start.startswith(b"\x28\xb5\x2f\xfd"):
        got = "a file compressed with zstd"
    raise InputError("p2o cannot read this bag", where=file, expected=_FORMS, got=got)


def _opened(file: Path, kind: str) -> Any:
    """Return an open reader of a file; SQLite files are checked."""
    if kind == ".db3":
        from rosbags.rosbag2 import storage_sqlite3

        check_sqlite(file)
        reader: Any = storage_sqlite3.Sqlite3Reader(escaped(file))
        with limited_connections(file):
            reader.open()
        return reader
    if kind == ".bag":
        from rosbags.rosbag1 import Reader

        reader = Reader(file)
    else:
        from rosbags.rosbag2 import storage_mcap

        # rosbags decompresses without a bound; this table is its only extension point.
        storage_mcap.DECOMPRESSORS.update(
            lz4=lambda data, size: _unpacked(_lz4(), data, size),
            zstd=lambda data, size: _unpacked(_zstd().ZstdDecompressor(), data, size),
        )
        reader = storage_mcap.McapReader(file)
    reader.open()
    return reader


def _bound_chunks(reader: Any) -> None:
    """Replace the decompressors of a ROS 1 reader by bounded ones."""
    import bz2

    from rosbags.rosbag1.reader import decompressors

    bounded: dict[Any, Callable[[bytes], bytes]] = {
        decompressors["none"]: lambda data: data,
        decompressors["bz2"]: lambda data: _unpacked(bz2.BZ2Decompressor(), data),
        decompressors["lz4"]: lambda data: _unpacked(_lz4(), data),
    }
    chunks = reader.chunks.items()
    reader.chunks = {place: chunk._replace(decompressor=bounded[chunk.decompressor]) for place, chunk in chunks}


def _lz4() -> Any:
    from lz4.frame import LZ4FrameDecompressor

    return LZ4FrameDecompressor()


def _zstd() -> Any:
    from rosbags.rosbag2.storage_mcap import zstd

    return zstd


def _unpacked(decompressor: Any, data: bytes, size: int | None = None) -> bytes:
    most = min(MAX_UNPACKED_BYTES, _UNPACKED_BYTES + _MAX_RATIO * len(data))
    size = most if size is None else size
    if size > most:
        raise InputError("a chunk is too large", expected=f"at most {most} bytes", got=f"{size} bytes")
    unpacked: bytes = decompressor.decompress(data, max_length=size)
    if not decompressor.eof:
        # Data that reach the bound may only lack the end mark.
        unpacked += decompressor.decompress(b"", max_length=1) if len(unpacked) == size else b""
    if len(unpacked) > size or not decompressor.eof:
        raise InputError("a chunk is truncated or larger than stated", got=f"more than {len(unpacked)} bytes")
    return unpacked


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Convert all exceptions of a reader for damaged bytes to InputError."""
    try:
        yield
    except GeneratorExit:
        raise
    except ModuleNotFoundError as problem:
        fault = f"bags need the package rosbags, which is not installed ({problem.name} is missing)"
        raise MethodUnavailable(fault, hint='run: pip install "rosbags>=0.11,<0.12"') from problem
    except P2OError as problem:
        if problem.where is not None or not isinstance(problem, InputError):
            raise
        raise InputError(problem.what, where=path, expected=problem.expected, got=problem.got) from problem
    except Exception as problem:
        message = f"{type(problem).__name__}: {problem}" if str(problem) else type(problem).__name__
        hint = "is it truncated? download it again, or try rosbag reindex, ros2 bag reindex, or mcap recover"
        if "not ros2" in message:
            hint = "only MCAP of ROS 2 is supported: convert others with their own tools"
        elif "protobuf" in message or "json" in message:
            hint = "only messages in the serialisation of ROS are supported: convert the recording to a ROS 2 bag"
        elif "reindex" in message:
            hint = "the recording was not closed: rosbag reindex FILE"
        raise InputError("the bag cannot be read", where=path, got=message[:200], hint=hint) from problem


def _close(readers: list[Any]) -> None:
    for reader in readers:
        with suppress(Exception):
            reader.close()
    readers.clear()
