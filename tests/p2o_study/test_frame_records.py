"""The record of a simulated frame is cached, and read again when anything that the frame depends on changes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from p2o_study import frame_records, worker
from p2o_study.frame_records import record_key
from p2o_study.worker import FrameRecord, Plugins, ReadJob, Source

from tests.p2o_study.source_edits import Edit
from tests.study_bench import PLUGIN

DATA = "synthetic:?place=room&width_px=96&height_px=64&lidar=vlp-16&right=false"
JOINED = '["poses@p2o-calib", {}]'
ON_BOARDS = '{"data": "synthetic:", "calibrator": "acsc", "witness": "none"}'


def source(data: str = DATA, options: str = "{}", index: int = 0, accumulate: str = "") -> Source:
    return Source(Plugins(), data, options, index, f"scene-{index:04d}", accumulate)


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> Callable[[ReadJob], FrameRecord | None]:
    """Return a function that reads a record and returns it only if its frame was not taken from the cache."""
    read, records = worker.read, []

    def counted(job: ReadJob) -> FrameRecord:
        records.append(read(job))
        return records[-1]

    monkeypatch.setattr(worker, "read", counted)

    def rendered(job: ReadJob) -> FrameRecord | None:
        records.clear()
        frame_records.read(job)
        return records[0] if records else None

    return rendered


def test_a_record_from_the_cache_is_that_of_the_frame(
    tmp_path: Path, rendered: Callable[[ReadJob], FrameRecord | None]
) -> None:
    job = ReadJob(source(), tmp_path)
    first = rendered(job)
    assert first is not None
    assert first.failure is None
    assert rendered(job) is None
    again = frame_records.read(job)
    assert (again.source, again.camera) == (first.source, first.camera)
    assert (again.inputs, again.digests, again.contents) == (first.inputs, first.digests, first.contents)
    for name in ("camera_from_lidar", "start", "twist"):
        assert np.array_equal(getattr(again, name), getattr(first, name)), name
    assert (again.camera_name, again.warnings, again.reason) == (first.camera_name, first.warnings, first.reason)


def test_a_damaged_file_of_the_cache_is_rendered_again(
    tmp_path: Path, rendered: Callable[[ReadJob], FrameRecord | None]
) -> None:
    job = ReadJob(source(), tmp_path)
    frame_records.read(job)
    [file] = tmp_path.rglob("*.npz")
    file.write_bytes(file.read_bytes()[:100])
    assert rendered(job) is not None


def test_what_a_frame_lacks_is_reported_also_with_a_cached_record(tmp_path: Path) -> None:
    frame_records.read(ReadJob(source(), tmp_path))
    for _ in range(2):
        record = frame_records.read(ReadJob(source(), tmp_path, checks=(ON_BOARDS,)))
        assert "the frame has no targets" in record.missing_inputs[ON_BOARDS]


def test_frames_of_files_and_of_other_datasets_are_read_each_time() -> None:
    assert record_key(source("kitti-raw:PATH")) == ""
    assert record_key(source("vkitti2:PATH")) == ""
    assert record_key(Source(Plugins(files=(str(PLUGIN),)), "tiny:", "{}", 0, "tiny/000")) == ""


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("p2o_sim/synthetic.py", "BASELINE_M = ", "BASELINE_M = 0.01 + "),
        ("p2o_sim/things/plants.py", "from __future__", "# read by a name that is put together\nfrom __future__"),
        ("p2o/geometry/camera.py", "def project", "def unused() -> None: ...\n\n    def project"),
        ("p2o/frames/sparse.py", "options.keep_rings > 1", "options.keep_rings > 2"),
        ("p2o_study/worker.py", "_DIGEST_DECIMALS = ", "_DIGEST_DECIMALS = 1 + "),
        ("p2o/cache.py", '"array {', '"an array {'),
    ],
)
def test_code_that_alters_a_frame_or_its_digests_makes_records_stale(edit: Edit, file: str, old: str, new: str) -> None:
    before = record_key(source())
    assert before
    edit(file, old, new)
    assert record_key(source()) != before


def test_code_of_methods_leaves_records_valid(edit: Edit) -> None:
    before = record_key(source())
    edit("p2o_plugins/match/ogm.py", '"LRUB", pattern', '"LRU", pattern')
    edit("p2o/run/pipeline.py", "import", "import zlib\nimport")
    assert record_key(source()) == before


def test_options_packages_and_accumulation_are_part_of_the_key(edit: Edit, monkeypatch: pytest.MonkeyPatch) -> None:
    joined = source(accumulate=JOINED)
    sources = [source(), source(index=1), source(options='{"seed": 1}'), source(DATA + "&keep_rings=2"), joined]
    keys = {record_key(each) for each in sources}
    assert len(keys) == len(sources)
    edit("p2o/run/joined.py", "class JoinedFrames", "_UNUSED = 1\n\n\nclass JoinedFrames")
    assert record_key(joined) in keys
    edit("p2o/run/joined.py", "self._accumulate.past)[::-1]", "self._accumulate.past)")
    assert record_key(joined) not in keys
    monkeypatch.setattr(frame_records, "_packages", lambda: ["numpy 99"])
    assert keys.isdisjoint(map(record_key, sources))
