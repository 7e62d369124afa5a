"""Computed frames are identified by their recipe: records are cached, and hashes are not those of arrays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import p2o_sim
import pytest
from p2o_study import worker
from p2o_study.worker import FrameRecord, Identity, Plugins, Source, identity_of, read

from tests.p2o_study.source_edits import Edit
from tests.study_bench import PLUGIN

DATA = "synthetic:?place=room&width_px=96&height_px=64&lidar=vlp-16&right=false"
JOINED = '["poses@p2o-calib", {}]'

Rendered = Callable[..., FrameRecord | None]


def source(data: str = DATA, options: str = "{}", index: int = 0, accumulate: str = "") -> Source:
    return Source(Plugins(), data, options, index, f"scene-{index:04d}", accumulate)


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> Rendered:
    """Return a function that reads a record and returns it only if its frame was not taken from the cache."""
    frame, count = worker._frame, []

    def counted(source: Source) -> object:
        count.append(source)
        return frame(source)

    monkeypatch.setattr(worker, "_frame", counted)

    def rendered(*job: Any) -> FrameRecord | None:
        count.clear()
        record = read(*job)
        return record if count else None

    return rendered


def test_a_record_from_the_cache_is_that_of_the_frame(tmp_path: Path, rendered: Rendered) -> None:
    job = source(), tmp_path
    first = rendered(*job)
    assert first is not None
    assert first.failure is None
    assert rendered(*job) is None
    again = read(*job)
    assert (again.source, again.camera) == (first.source, first.camera)
    assert (again.inputs, again.digests, again.contents) == (first.inputs, first.digests, first.contents)
    for name in ("camera_from_lidar", "start", "twist"):
        assert np.array_equal(getattr(again, name), getattr(first, name)), name
    assert (again.camera_name, again.warnings, again.reason) == (first.camera_name, first.warnings, first.reason)


def test_a_damaged_file_of_the_cache_is_rendered_again(tmp_path: Path, rendered: Rendered) -> None:
    job = source(), tmp_path
    read(*job)
    [file] = tmp_path.rglob("*.npz")
    file.write_bytes(file.read_bytes()[:100])
    assert rendered(*job) is not None


def test_frames_of_files_and_of_other_datasets_are_read_each_time(tmp_path: Path) -> None:
    tiny = Source(Plugins(files=(str(PLUGIN),)), "tiny:", "{}", 0, "tiny/000")
    assert identity_of(tiny) is None
    record = read(tiny, tmp_path)
    assert record.inputs == worker.input_hashes(worker._frame(tiny))
    assert record.digests == worker.content_digests(worker._frame(tiny))


def test_hashes_are_those_of_the_recipe(monkeypatch: pytest.MonkeyPatch, edit: Edit) -> None:
    def identity(*words: str, **values: object) -> Identity:
        worker._opened.cache_clear()
        found = identity_of(source(*words, **values))  # type: ignore[arg-type]
        assert found is not None
        return found

    first, joined = identity(), identity(accumulate=JOINED)
    assert first.input_hashes["sweep"] == first.input_hashes["cloud"]
    assert len({*first.input_hashes.values()}) == 3
    for others in (identity(DATA + "&scenes=2"), identity(DATA + "&seed=0")):
        assert others == first
    # An accumulated sweep leaves the image and the own sweep of the frame.
    assert {name for name in first.input_hashes if first.input_hashes[name] != joined.input_hashes[name]} == {
        "cloud",
        "frame",
    }
    assert joined.content_digests == first.content_digests
    known = {identity(options='{"seed": 1}').frame, identity(DATA + "&keep_rings=2").frame, first.frame, joined.joined}
    known |= {identity(DATA + "&scenes=2", index=1).frame, identity(DATA + "&scenes=2", accumulate=JOINED).joined}
    edit("p2o_plugins/accumulate/joining.py", "max_range_m=options.max_range_m)", "max_range_m=None)")
    known.add(identity(accumulate=JOINED).joined)
    assert len(known) == 7
    monkeypatch.setattr(p2o_sim, "VERSION", p2o_sim.VERSION + 1)
    assert identity().frame not in known


def test_the_cached_record_has_the_version_of_the_algorithm(
    tmp_path: Path, rendered: Rendered, monkeypatch: pytest.MonkeyPatch
) -> None:
    read(source(), tmp_path)
    monkeypatch.setattr(worker, "ALGORITHM", worker.ALGORITHM + 1)
    assert rendered(source(), tmp_path) is not None
