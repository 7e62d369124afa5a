"""A study computes each row once, whatever happens to it on the way, and the same bits wherever it runs."""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import random
import re
import sys
import time
from collections import Counter
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import InputError, MethodUnavailable, se3
from p2o.cli import main
from p2o_study import parallel, worker
from p2o_study.ablate import parse_seeds
from p2o_study.parallel import Workers
from p2o_study.rows import Rows
from p2o_study.study import Published, RowTable, Study, check_study, parse_study
from p2o_study.summary import summary_of_stored
from p2o_study.worker import Plugins

from tests.study_bench import HEAD, QUICK, STAGED, TRUSTED, Bench, bits

SHORT = STAGED.replace('"nearest"', "").replace("seeds = 2", "seeds = 1")


def test_features_are_extracted_once_for_all_seeds_matchers_solvers_and_studies(bench: Bench) -> None:
    done = bench.run(STAGED)
    assert (done.computed, len(done.rows), done.missing) == (24, 24, [])
    assert all(row.solved for row in done.rows)
    assert bench.calls() == {"frame": 3, "image": 3, "cloud": 3}

    worker._features.values.clear()
    other = STAGED.replace('name = "tiny"', 'name = "other"', 1).replace(
        "[[product]]", "options.pipeline.rounds = 2\n[[product]]"
    )
    assert bench.run(other, out="elsewhere").computed == 24
    calls = bench.calls()
    assert calls["image"] == calls["cloud"] == 0


def test_changing_an_option_extracts_again_only_what_it_acts_on(bench: Bench) -> None:
    text = HEAD + '[[row]]\nlabel = "a"\n' + TRUSTED
    bench.run(text)
    bench.calls()
    for change, expected in (
        ("options.solver.tolerance = 1e-7\n", {}),
        ("options.matcher.neighbours = 6\n", {}),
        ("options.damage.missing_edges = 0.1\n", {}),
        ("options.extractor.step = 0.04\n", {"image": 3}),
        ("options.cloud.step = 0.3\n", {"cloud": 3}),
        ("options.data.salt = 1\n", {"image": 3}),
    ):
        worker._features.values.clear()
        done = bench.run(text + change)
        assert done.computed == 6, change
        calls = bench.calls()
        del calls["frame"]
        assert calls == expected, change


def test_a_study_that_is_finished_computes_nothing_and_an_edited_one_what_is_new(bench: Bench) -> None:
    first = bench.run(STAGED)
    assert bench.run(STAGED).computed == 0
    assert bits(bench.run(STAGED).rows) == bits(first.rows)
    more = bench.run(STAGED.replace("seeds = 2", "seeds = 3").replace("frames = 3", "frames = 4"))
    assert (more.computed, len(more.rows)) == (4 * 12 - 24, 48)
    fewer = bench.run(STAGED.replace('["lm", "scipy"]', '["lm"]'))
    assert (fewer.computed, len(fewer.rows)) == (0, 12), "rows that are no longer asked for are not shown"
    renamed = bench.run(STAGED.replace("[[product]]", '[[product]]\nlabel = "{matcher} and {solver}"'))
    assert renamed.computed == 0
    assert {row.row for row in renamed.rows} >= {"ogm and lm", "nearest and scipy"}


def test_a_row_is_what_p2o_run_gives_for_the_same_words(bench: Bench) -> None:
    text = STAGED + '[[row]]\nlabel = "joint"\njoint = true\n'
    registry = bench.plugins.registry()
    rows = [row for row in bench.run(text).rows if row.method.words["matcher"] == "ogm"]
    assert len(rows) == 12 + 2
    for row in rows[::3]:
        options = {**row.method.options, "data": row.case.options}
        words = {**row.method.words, "options": options, "seed": row.seed, "joint": bool(row.case.joint)}
        words |= {"data": f"{row.case.data}:", "frames": ",".join(row.frames), "perturb": row.case.protocol}
        again = p2o.calibrate(registry=registry, **words).rows[0]
        np.testing.assert_allclose(again.result.camera_from_lidar, row.estimate, rtol=0, atol=1e-9)
        # The pipeline cleans its start: a rotation is one to the last bit.
        np.testing.assert_allclose(again.result.start, row.case.start, atol=1e-9)
        assert again.result.status == row.status
        assert again.error.rotation_deg == pytest.approx(row.error_of("rotation_deg"), abs=1e-6)
        assert again.start_error.translation_m == pytest.approx(row.start_error_of("translation_m"), abs=1e-8)


def test_groups_of_frames_are_solved_together_each_from_a_start_of_its_own(bench: Bench) -> None:
    rows = bench.run(QUICK.replace("frames = 3", "frames = 5") + "joint = 2\n").rows
    groups = [("tiny/000", "tiny/001"), ("tiny/002", "tiny/003"), ("tiny/004",)]
    assert [(row.frames, row.case.joint) for row in rows[::2]] == [(group, len(group)) for group in groups]
    assert len({row.case.start.tobytes() for row in rows}) == len(rows)
    assert [round(row.start_error_of("rotation_deg"), 6) for row in rows] == [1.0] * 6


def test_a_row_begins_where_a_list_says_and_a_changed_line_is_another_row_of_its_frame_alone(
    bench: Bench, tmp_path: Path
) -> None:
    starts = tmp_path / "starts.txt"
    lines = ["0.01 0 0 0 0 0.1", "0 0.02 0 0 0.2 0", "0 0 0.03 0.3 0 0"]
    starts.write_text("\n".join(lines))
    text = QUICK.replace("1deg 0.05m", f"camera @{starts}")
    rows = bench.run(text).rows
    assert len(rows) == 6
    for row in rows:
        error = se3.exp(np.array(lines[int(row.frames[0][-3:])].split(), float))
        np.testing.assert_allclose(row.case.start, error @ row.case.truth, atol=1e-8)
    assert bench.run(text).computed == 0
    starts.write_text("\n".join([lines[0], lines[1], "0 0 0.04 0.3 0 0"]))
    changed = bench.run(text)
    assert changed.computed == 2, "both seeds of the frame whose line has changed"
    joint = bench.run(text + "joint = 2\n").rows
    assert {round(row.start_error_of("rotation_deg"), 6) for row in joint} == {
        round(np.degrees(a), 6) for a in (0.01, 0.04)
    }
    starts.write_text("\n".join(lines[:2]))
    with pytest.raises(InputError, match=r"too short.*frame tiny/002"):
        bench.run(text)


def test_a_run_that_raises_is_a_row_that_says_why_and_is_tried_again(bench: Bench) -> None:
    text = QUICK + 'options.calibrator.fail_on = "tiny/001"\n'
    done = bench.run(text)
    crashed = [row for row in done.rows if row.crashed]
    assert [(row.frames, row.status) for row in crashed] == [(("tiny/001",), "stage-failed")] * 2
    assert "raised ValueError while calibrating; got no such luck" in crashed[0].reason
    assert "in calibrate" in crashed[0].exception
    assert crashed[0].estimate is None
    assert crashed[0].case.start is not None
    assert len(done.rows) == 6
    assert bench.run(text).computed == 2


def test_a_frame_that_cannot_be_read_and_features_that_cannot_be_had_are_rows_too(bench: Bench) -> None:
    text = HEAD.replace("frames = 3", "frames = 3, bad = 1") + '[[row]]\nlabel = "a"\noptions.extractor.fail_on = 2\n'
    good, unread, unliked = bench.run(text).rows[::2]
    assert good.solved
    assert (unread.frames, unread.crashed, unread.case.start) == (("tiny/001",), True, None)
    assert "the image is cut short" in unread.reason
    assert "this picture is not liked" in unliked.reason
    assert "ValueError" in unliked.exception


def test_what_is_wrong_is_told_before_any_work(bench: Bench) -> None:
    with pytest.raises(InputError, match=r"row 'b'.*try --matcher"):
        bench.run(STAGED + '[[row]]\nlabel = "b"\nextractor = "tiny-plain/tiny"\n')
    with pytest.raises(InputError, match=r"row 'b'.*the frame has no right; stereo needs it"):
        bench.run(HEAD + '[[row]]\nlabel = "a"\n[[row]]\nlabel = "b"\nextractor = "stereo/tiny"\n')
    with pytest.raises(InputError, match=r"dataset 'tiny': frame index 7"):
        bench.run(QUICK.replace("frames = 3 }", 'frames = 3 }\nframes = "7"'))
    assert bench.calls()["quick"] == 0
    assert bench.run(QUICK).computed == 6


def test_a_later_frame_that_lacks_what_a_row_needs_is_a_row_that_says_so(bench: Bench) -> None:
    head = HEAD.replace("frames = 3", "frames = 3, with_right = 2")
    rows = bench.run(head + '[[row]]\nlabel = "one"\n[[row]]\nlabel = "two"\nextractor = "tiny-right/tiny"\n').rows
    assert [row.solved for row in rows if row.row == "one"] == [True] * 6, "other rows do not mind"
    assert [row.solved for row in rows if row.row == "two"] == [True] * 4 + [False] * 2
    assert all("the frame has no right; tiny-right needs it" in row.reason for row in rows if row.crashed)
    joint = bench.run(head + '[[row]]\nlabel = "two"\nextractor = "tiny-right/tiny"\njoint = true\n').rows
    assert ["tiny/002: the frame has no right" in row.reason for row in joint] == [True] * 2


def test_a_whole_method_reads_each_frame_once_for_all_seeds_of_a_joint_row(bench: Bench) -> None:
    assert bench.run(QUICK.replace("frames = 3", "frames = 12") + "joint = true\n").computed == 2
    assert bench.calls()["frame"] == 12


def test_frames_in_memory_are_bounded_by_their_bytes(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker._frames, "most", 3 * 600 * 180 * 3)
    bench.run(QUICK.replace("frames = 3", "frames = 5"))
    assert len(worker._frames.values) == 2, "three pictures of 600 x 180 px, but not their sweeps"


def test_ctrl_c_keeps_the_rows_that_are_finished(bench: Bench) -> None:
    # Both seeds have the same method with the same options, which is built once: its second call is the second row.
    done = bench.run(QUICK + "options.calibrator.interrupt_after = 2\n")
    assert done.interrupted
    assert (done.computed, len(done.rows), len(done.missing)) == (1, 1, 5)


def test_progress_tells_rows_failures_and_the_time_that_is_left(bench: Bench) -> None:
    told = []
    bench.run(QUICK + 'options.calibrator.fail_on = "tiny/001"\n', on_progress=told.append)
    rows = [p for p in told if p.phase == "calibrate"]
    assert [p.done for p in rows][-7:] == [0, 1, 2, 3, 4, 5, 6]
    assert (rows[-1].total, rows[-1].failed, rows[-1].seconds_left) == (6, 2, 0)
    assert rows[-3].seconds_left > 0
    assert rows[-1].name == "quick, tiny/002, seed 1"
    again = []
    bench.run(QUICK, on_progress=again.append)
    bench.run(QUICK, on_progress=again.append)
    assert (again[-1].done, again[-1].kept) == (6, 6)


@pytest.mark.system
def test_two_processes_of_one_machine_give_the_same_bits_as_one(bench: Bench) -> None:
    text = SHORT + '[[row]]\nlabel = "quick"\ncalibrator = "quick"\n[[row]]\nlabel = "all"\njoint = true\n'
    alone = bench.run(text)
    both = bench.run(text, out="both", jobs=2)
    assert both.computed == alone.computed
    assert bits(both.rows) == bits(alone.rows)


@pytest.mark.parametrize("jobs", [1, 2])
def test_whatever_a_method_raises_is_a_row_that_names_it(bench: Bench, jobs: int) -> None:
    kinds = ("SystemExit", "GeneratorExit", "BaseException")
    row = '[[row]]\nlabel = "{0}"\ncalibrator = "quick"\nwitness = "none"\n'
    row += 'options.calibrator = {{ fail_on = "tiny/001", raises = "{0}" }}\n'
    done = bench.run(HEAD + "".join(map(row.format, kinds)), jobs=jobs)
    for raised in kinds:
        rows = [row for row in done.rows if row.row == raised]
        reasons = [row.reason for row in rows if row.crashed]
        assert len(reasons) == 2
        assert all(f"calibrator 'quick' raised {raised} while calibrating" in reason for reason in reasons)
        assert sum(row.solved for row in rows) == 4


def test_the_order_of_the_chosen_frames_does_not_change_a_joint_row(bench: Bench) -> None:
    text = HEAD.replace("options =", 'frames = "ORDER"\noptions =') + '[[row]]\nlabel = "a"\njoint = true\n'
    given = bench.run(text.replace("ORDER", "0,1,2"))
    assert bits(bench.run(text.replace("ORDER", "2,0,1"), out="again").rows) == bits(given.rows)


@pytest.mark.system
@pytest.mark.parametrize(("jobs", "by"), [("1", "SIGSEGV"), ("2", "SIGABRT")])
def test_a_plugin_that_crashes_is_a_row_and_its_worker_prints_nothing(bench: Bench, jobs: str, by: str) -> None:
    text = QUICK + f'options.calibrator = {{ die_on = "tiny/001", die_by = "{by}" }}\n'
    done = bench.cli(text, "--jobs", jobs, "--quiet")
    assert (done.returncode, done.stderr) == (1, "")
    assert "2 (2 crashed)" in done.stdout
    assert all(by in row.reason for row in Rows(bench.root / "out").planned("tiny") if row.crashed)


def test_jobs_run_in_this_process_where_no_worker_can_be_started(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("p2o_study.parallel._cannot_start", lambda: "/dev/shm: Read-only file system")
    with Workers(2).start() as run:
        assert list(run(abs, iter([-1, -2]), lambda job, problem: job)) == [1, 2]
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("p2o: warning: worker processes cannot be started")
    assert "/dev/shm: Read-only file system" in line


@pytest.mark.system
def test_a_study_outlives_a_worker_that_is_killed(bench: Bench) -> None:
    text = QUICK + f'options.calibrator.die_once = "{bench.root / "died"}"\n'
    done = bench.run(text, jobs=2)
    assert (bench.root / "died").exists(), "a worker was killed"
    assert (done.computed, len(done.rows), done.missing) == (6, 6, [])
    assert bits(done.rows) == bits(bench.run(text, out="alone").rows)


@pytest.mark.system
def test_a_frame_whose_reader_is_killed_is_a_row_that_says_so(bench: Bench) -> None:
    done = bench.run(HEAD.replace("frames = 3", "frames = 3, deadly = 1") + '[[row]]\nlabel = "a"\n', jobs=2)
    assert [row.frames for row in done.rows if row.crashed] == [("tiny/001",)] * 2
    assert all("the worker process died" in row.reason for row in done.rows if row.crashed)
    assert sum(row.solved for row in done.rows) == 4


def test_short_jobs_go_to_a_worker_several_at_once_and_long_ones_alone() -> None:
    """(duration of a batch, its jobs): jobs of the next one, which is at most twice as large, and at most 64."""
    sizes = {
        (0.001, 1): 2,
        (0.01, 20): 40,
        (0.01, 60): 64,
        (0.5, 8): 16,
        (1.0, 8): 8,
        (4.0, 8): 2,
        (0.7, 1): 1,
        (90, 8): 1,
    }
    assert {known: parallel._batch_size(*known) for known in sizes} == sizes


@pytest.mark.system
def test_of_a_batch_whose_worker_dies_the_other_jobs_are_done(bench: Bench) -> None:
    """Which of them it was nobody knows: each answers for itself."""
    head = QUICK.replace("frames = 3", "frames = 40")
    done = bench.run(head + 'options.calibrator.die_on = "tiny/035"\n', jobs=2)
    crashed = [row for row in done.rows if row.crashed]
    assert [row.frames for row in crashed] == [("tiny/035",)] * 2
    assert all("the worker process died in each of 3 attempts" in row.reason for row in crashed)
    assert "SIGKILL" in crashed[0].reason
    assert (sum(row.solved for row in done.rows), done.missing) == (78, [])


def test_more_calibrations_than_anyone_can_wait_for_are_refused_before_a_frame_is_read(bench: Bench) -> None:
    text = QUICK.replace("frames = 3", "frames = 20").replace("seeds = 2", "seeds = 10000")
    with pytest.raises(InputError, match=r"too many calibrations; expected at most 100000; got 200000.*--at-most N"):
        bench.run(text)
    twice = text.replace("seeds = 10000", "seeds = 15000").replace("frames = 20", "frames = 1")
    with pytest.raises(InputError, match=r"seeds"):
        bench.run(twice)
    rows = "".join(f'[[row]]\nlabel = "r{n}"\ncalibrator = "quick"\n' for n in range(3))
    with pytest.raises(InputError, match=r"40000 rows times seeds; expected at most 20000; .*--at-most N"):
        bench.run(text + rows)
    assert bench.calls() == {}


def test_more_are_computed_where_they_are_confirmed(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = bench.run(QUICK, out="held")
    monkeypatch.setattr("p2o_study.ablate.MAX_CALIBRATIONS", 5)
    with pytest.raises(InputError, match="at most 5; got 6"):
        bench.run(QUICK)
    found = bench.run(QUICK, at_most=6)
    assert bits(found.rows) == bits(expected.rows)
    assert (len(found.rows), len(found.missing)) == (6, 0)
    words = bench.words(QUICK, "--quiet", "--jobs", "1", "--no-isolate")
    assert main(words) == 2
    assert main([*words, "--at-most", "6"]) == 0


@pytest.mark.system
@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason='needs pip install ".[dask]"')
def test_a_dask_cluster_gives_the_same_bits_though_a_worker_is_killed(bench: Bench) -> None:
    text = (
        SHORT
        + f'[[row]]\nlabel = "quick"\ncalibrator = "quick"\noptions.calibrator.die_once = "{bench.root / "died"}"\n'
    )
    done = bench.cli(text, "--backend", "dask", "--jobs", "2", "--quiet")
    assert done.returncode == 0, done.stderr
    assert (bench.root / "died").exists(), "a worker was killed"
    alone = bench.run(text, out="alone")
    assert bits(Rows(bench.root / "out").planned("tiny")) == bits(alone.rows)


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason='needs pip install ".[ray]"')
def test_ray_gives_the_same_bits_and_tells_a_job_that_kills_its_worker(bench: Bench) -> None:
    text = STAGED + '[[row]]\nlabel = "quick"\ncalibrator = "quick"\noptions.calibrator.die_on = "tiny/001"\n'
    done = bench.cli(text, "--backend", "ray", "--jobs", "2", "--quiet")
    assert done.returncode == 1, done.stderr
    found = Rows(bench.root / "out").planned("tiny")
    assert [row.frames for row in found if row.crashed] == [("tiny/001",)] * 2
    assert all("the worker process died" in row.reason for row in found if row.crashed)
    # The bits are compared where nobody dies.
    alone = bench.run(STAGED, out="alone").rows
    assert bits([row for row in found if row.row != "quick"]) == bits(alone)


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason='needs pip install ".[ray]"')
def test_a_ray_cluster_that_does_not_exist_is_named_at_once() -> None:
    with pytest.raises(InputError, match="ray cluster does not respond"), Workers(1, "ray", "127.0.0.1:9").start():
        pass


@pytest.mark.parametrize(("backend", "packages"), [("dask", "dask distributed"), ("ray", "ray")])
def test_a_backend_that_is_not_installed_tells_its_packages(
    backend: str, packages: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("distributed", "ray"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MethodUnavailable, match=rf"run: pip install {packages}$"):
        Workers(2, backend)


def test_threads_of_this_process_are_left_as_they_were() -> None:
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with Workers(1).start() as run:
            assert list(run(lambda _: cv2.getNumThreads(), [0, 0], lambda job, problem: None)) == [1, 1]
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


def _study_in_child(root: Path, text: str) -> None:
    """Run a study in the process of a child."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    os.environ["TINY_CALLS"] = str(root / "calls")
    os.environ.pop("P2O_PLUGINS", None)
    (root / "began").touch()
    Bench(root).run(text)


def _in_child(bench: Bench, text: str) -> BaseProcess:
    """Start a study in a process that has most modules loaded already, and return once it begins.

    It is forked off a server, not off this process: OpenCV's threads, which other tests have started here, do not
    live on in a fork, and `cv2.setNumThreads` would wait for them without end.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "cv2", "scipy.linalg", "scipy.optimize", "threadpoolctl"])
    child = context.Process(target=_study_in_child, args=(bench.root, text), daemon=True)
    (bench.root / "began").unlink(missing_ok=True)
    child.start()
    _wait_for(lambda: (bench.root / "began").exists(), child)
    return child


def _wait_for(happened: Callable[[], bool], child: BaseProcess) -> None:
    """Wait until something has happened, for as long as the child lives, a minute at most."""
    until = time.monotonic() + 60
    while not happened() and child.is_alive() and time.monotonic() < until:
        time.sleep(0.001)


KILLS = 56
LONG = QUICK.replace("seeds = 2", "seeds = 30").replace("frames = 3", "frames = 5")


def _keys(folder: Path) -> set[str]:
    return {f"{row.frames[0]} {np.abs(row.case.start).sum():.6f}" for row in Rows(folder).each("tiny")}


@pytest.mark.system
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forked processes")
def test_a_study_that_is_killed_at_any_moment_goes_on_and_computes_no_finished_row_again(bench: Bench) -> None:
    rng = random.Random(0)
    text = LONG + "options.calibrator.sleep_s = 0.001\n"
    folder = bench.root / "out"
    computed: Counter[str] = Counter()
    finished: set[str] = set()
    window_s = 0.02
    for kill in range(KILLS):
        child = _in_child(bench, text)
        # Half of the kills fall into reading, planning and making the store, the others among the rows.
        if kill % 2:
            _wait_for(lambda: bench.calls_file.exists() and "quick" in bench.calls_file.read_text(), child)
        time.sleep(rng.uniform(0, window_s))
        child.kill()
        child.join()
        lines = bench.calls_file.read_text().splitlines() if bench.calls_file.exists() else []
        bench.calls_file.unlink(missing_ok=True)
        calls = [line.removeprefix("quick ") for line in lines if line.startswith("quick ")]
        assert not finished & set(calls), "a row that was finished before was computed again"
        computed.update(calls)
        now = _keys(folder)
        assert now >= finished, "a finished row was lost"
        assert len(set(calls) - now) <= 1, "at most the row under way is lost with the process"
        # On a busy machine a row takes longer than the window: widen it until rows get through.
        window_s = 0.02 if len(now) > len(finished) else min(2.0, 1.3 * window_s)
        finished = now
    assert len(finished) > 5
    done = bench.run(text)
    assert len(done.rows) == 150
    assert done.missing == []
    alone = bench.run(text, out="alone")
    assert bits(done.rows) == bits(alone.rows)


@pytest.mark.system
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_two_processes_share_one_study_without_harm(bench: Bench) -> None:
    text = LONG + "options.calibrator.sleep_s = 0.004\n"
    children = [_in_child(bench, text) for _ in range(2)]
    for child in children:
        child.join(300)
    assert [child.exitcode for child in children] == [0, 0]
    # They begin at opposite ends; only where they meet may both compute a row.
    assert 150 <= bench.calls()["quick"] <= 154
    done = bench.run(text)
    assert done.computed == 0
    assert bits(done.rows) == bits(bench.run(text, out="alone").rows)


def test_the_command_prints_what_is_measured_beside_what_is_published(bench: Bench, capsys, monkeypatch) -> None:
    monkeypatch.setenv("P2O_CACHE", str(bench.root))
    published = '[[published]]\nlabel = "RGGNet"\nsource = "2020"\nbeside = "quick"\nvalues = { rotation_deg = 1.18 }\n'
    words = bench.words(QUICK + published, "--jobs", "1", "--no-isolate")
    assert main([*words, "--frames", "0,1", "--seeds", "3"]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[0] == "Tiny"
    cells = dict(zip(re.split("  +", lines[1].strip()), re.split("  +", lines[2].strip())[1:], strict=True))
    assert [cells[name] for name in ("runs", "frames", "doubtful")] == ["6", "2", "6"]
    names = ("rotation mean [deg]", "rotation median [deg]", "translation mean [cm]", "translation median [cm]")
    assert [cells[name] for name in names] == ["0.500", "0.500", "2.5", "2.5"]
    assert float(cells["time [s]"]) >= 0
    assert re.split("  +", lines[3].strip())[0] == "RGGNet (published)"
    assert any(line.startswith("RGGNet: 2020") for line in lines)
    assert "1.180" in lines[3]
    assert "p2o: calibrating: 6 of 6 (quick, tiny/001, seed 2)" in err
    assert "6 rows computed" in err
    assert main([*words, "--quiet", "--frames", "0,1", "--seeds", "3"]) == 0
    assert capsys.readouterr().err == ""
    assert main(bench.words(QUICK + 'options.calibrator.fail_on = "tiny/001"\n', *words[6:])) == 1
    assert "2 (2 crashed)" in capsys.readouterr().out
    assert main(bench.words(QUICK + "options.calibrator.interrupt_after = 2\n", *words[6:])) == 130
    assert "the same command continues" in capsys.readouterr().err


def test_the_command_lists_studies_and_refuses_what_it_cannot_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ablate", "--list"]) == 0
    assert "smoke " in capsys.readouterr().out
    for words, told in (
        ([], "STUDY is missing"),
        (["smok"], "did you mean smoke"),
        (["smoke", "--seeds", "none"], "cannot read the seeds"),
        (["smoke", "--update"], "--gate FILE"),
        (["smoke", "--address", "tcp://x:1"], "has no address"),
    ):
        assert main(["ablate", *words]) == 2
        assert told in capsys.readouterr().err


def test_seeds_are_a_number_or_a_list() -> None:
    assert parse_seeds("10") == 10
    assert parse_seeds("3, 5") == (3, 5)
    assert parse_seeds("0,4294967295") == (0, 4294967295)
    for text in ("0", "", "-1", "1,", "a", "10001", "9" * 5000, "4294967296,1", "1," * 10_000 + "1", "٣", "1.0", "1 2"):
        with pytest.raises(InputError, match="--seeds"):
            parse_seeds(text)


@pytest.mark.system
def test_the_gate_of_the_how_to_works_with_the_example_plugin(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "ablation-ci.md").read_text(encoding="utf-8")
    [study] = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    example = Path(__file__).parents[1] / "example_plugin"
    monkeypatch.syspath_prepend(str(example))
    monkeypatch.setenv("P2O_CACHE", str(bench.root))
    file, reference = bench.root / "example-gate.toml", bench.root / "reference.json"
    file.write_text(study)
    words = ["ablate", str(file), "--plugin", str(example / "p2o_example" / "hooks.py"), "--quiet", "--jobs", "1"]
    words += ["--out", str(bench.root / "out"), "--gate", str(reference)]
    assert main([*words, "--update"]) == 0
    assert main(words) == 0
    assert "gate: open" in capsys.readouterr().out
    # A judge that hardly sees beyond the edges does not refine what the solver left.
    worse = "options.pipeline = { rounds = 1, reach_px = 4, judge_px = 1.01 }\noptions.solver.iterations = 1\n"
    file.write_text(study + worse)
    assert main(words) == 1
    out = capsys.readouterr().out
    assert "FAIL  gauss-newton: mean rotation_deg" in out
    assert "FAIL  grey-steps" not in out


def test_the_study_of_the_page_on_studies_is_one() -> None:
    page = (Path(__file__).parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
    [text] = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    study = parse_study(text)
    assert [row.label for row in check_study(study, Plugins().registry())] == ["ogm", "ogm-lr", "nearest", "ogm, wide"]
    for name in (*Study.model_fields, *RowTable.model_fields, *Published.model_fields):
        assert f"`{name}`" in page or f"[[{name}]]" in page or f"[{name}]" in page or f"{name}." in page, name


def test_datasets_that_are_left_out_are_told_and_the_others_run(
    bench: Bench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = QUICK + '[[dataset]]\nname = "more"\ndata = "tiny:"\noptional = true\n[[published]]\nlabel = "p"\n'
    text += 'source = "q"\nvalues = {}\nbeside = "quick @ more"\n'
    told: list[str] = []
    done = bench.run(text, on_warning=told.append)
    assert {row.row for row in done.rows} == {"quick @ tiny"}
    assert told == ["datasets without a path are left out: more (--root DIR or --data NAME=DATASET:PATH)"]
    monkeypatch.setenv("P2O_CACHE", str(bench.root))
    words = bench.words(text, "--jobs", "1", "--no-isolate", out="shell")
    assert main([*words, "--frames", "tiny=0", "--seeds", "1"]) == 0
    assert "datasets without a path are left out: more" in capsys.readouterr().err
    rows = Rows(bench.root / "shell")
    assert [row.frames for row in rows.planned("tiny")] == [("tiny/000",)]
    summary = summary_of_stored(rows, rows.study("tiny"))
    assert summary is not None
    assert [row.label for group in summary.groups for row in group.rows] == ["quick @ tiny"], "published ones left out"


def test_all_frames_of_a_camera_are_one_calibration_that_one_broken_frame_does_not_spoil(bench: Bench) -> None:
    done = bench.run(HEAD.replace("frames = 3", "frames = 4, bad = 1") + '[[row]]\nlabel = "a"\njoint = "camera"\n')
    assert {(row.frames, row.case.joint, row.solved) for row in done.rows} == {
        (("tiny/000", "tiny/002", "tiny/003"), 3, True),
        (("tiny/001",), 1, False),
    }


def test_velocity_and_camera_of_a_frame_are_known_to_whoever_calibrates_its_features(tmp_path: Path) -> None:
    """Features alone do not tell them, and an offset in time and groups of frames need them."""
    data = "synthetic:?cameras=front&width_px=160&height_px=64&lidar=vlp-16&right=false&speed_m_s=7"
    source = worker.Source(Plugins(), data, "{}", 0, "scene-0000/front")
    facts = worker.read(source, tmp_path)
    assert facts.reason == ""
    assert np.isclose(np.linalg.norm(facts.twist[3:]), 7, atol=0.5)
    assert facts.camera_name == "front"


def test_the_command_writes_a_report_with_the_chosen_columns(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    text = QUICK + 'joint = 2\n[[row]]\nlabel = "quick alone"\ncalibrator = "quick"\nwitness = "none"\n'
    words, out = bench.words(text, "--jobs", "1", "--no-isolate", "--quiet"), bench.root / "out"
    assert main([*words, "--report", "--columns", "rotation meen"]) == 2
    assert "--columns: unknown column 'rotation meen'" in capsys.readouterr().err
    assert bench.calls()["quick"] == 0, "refused before any work"
    assert main([*words, "--report", "--columns", "runs,translation mean"]) == 0
    assert re.split("  +", capsys.readouterr().out.splitlines()[1].strip()) == ["runs", "translation mean [cm]"]
    assert "row & runs & translation mean [cm] \\\\" in (out / "report/report.tex").read_text()
    figures = {path.name for path in (out / "report").glob("*over-frames*")}
    assert figures == {f"tiny-1-over-frames.{form}" for form in ("pdf", "png", "svg")}
