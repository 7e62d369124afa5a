"""What goes wrong around a study costs what it must and no more: disks, signals, folders, caches."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from p2o import InputError
from p2o.cache import FeatureCache
from p2o.cli import main
from p2o_study import worker
from p2o_study.row import Row
from p2o_study.rows import Rows

from tests.study_bench import HEAD, QUICK, Bench, bits

ONE = HEAD + '[[row]]\nlabel = "a"\n'


def forget() -> None:
    """Let this process forget what it has in memory."""
    worker._features.values.clear()
    worker._frames.values.clear()


# ---- the cache


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_cache_that_cannot_be_written_costs_one_warning_and_no_row(bench: Bench, jobs: int) -> None:
    expected = bench.run(ONE)
    forget()
    (bench.root / "cache").rename(bench.root / "gone")
    (bench.root / "cache").write_text("a file in the place of the folder")
    told: list[str] = []
    done = bench.run(ONE, out="again", jobs=jobs, on_warning=told.append)
    assert bits(done.rows) == bits(expected.rows)
    [warning] = told
    assert warning.startswith(f"{bench.root / 'cache'}")
    assert "the cache of features cannot be written" in warning
    assert "P2O_CACHE" in warning


def test_python_warns_where_nobody_asks(bench: Bench) -> None:
    (bench.root / "cache").write_text("")
    with pytest.warns(UserWarning, match="the cache of features cannot be written") as told:
        bench.run(ONE)
    assert sum("cache of features" in str(warning.message) for warning in told) == 1


def test_a_disk_that_fills_up_under_the_cache_costs_time_alone(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = bench.run(ONE)
    forget()

    replace = os.replace

    def full(source: str, target: str) -> None:
        if Path(target).is_relative_to(bench.root / "cache"):
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    told: list[str] = []
    with monkeypatch.context() as patch:
        patch.setattr(FeatureCache, "get", lambda *_: None)
        patch.setattr(FeatureCache, "has", lambda *_: False)
        assert bits(bench.run(ONE, out="again", on_warning=told.append).rows) == bits(expected.rows)
    assert len(told) == 1
    assert "No space left" in told[0]


def test_the_command_warns_in_one_line_though_it_is_quiet(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (bench.root / "file").write_text("")
    monkeypatch.setenv("P2O_CACHE", str(bench.root / "file" / "cache"))
    assert main(bench.words(ONE, "--jobs", "1", "--quiet")) == 0
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("p2o: warning: ")


@pytest.mark.parametrize(
    ("variable", "value"), [("P2O_CACHE", "/proc/nothing"), ("XDG_CACHE_HOME", "/dev/null"), ("XDG_CACHE_HOME", "x\ny")]
)
def test_a_users_folder_that_cannot_be_written_is_no_end_of_a_study(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, variable: str, value: str
) -> None:
    monkeypatch.chdir(bench.root)
    monkeypatch.delenv("P2O_CACHE", raising=False)
    monkeypatch.setenv(variable, value)
    assert main(bench.words(QUICK, "--jobs", "1", "--quiet")) == 0


def test_a_home_that_is_nobodys_is_told(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = bench.words(QUICK, "--jobs", "1", "--quiet")
    monkeypatch.setenv("P2O_CACHE", "~nosuch/cache")
    assert main(words) == 2
    assert "the home folder of an unknown user" in capsys.readouterr().err
    monkeypatch.setenv("P2O_CACHE", str(bench.root / "cache"))
    assert main([*words, "--out", "~nosuch/out"]) == 2
    assert "~nosuch/out" in capsys.readouterr().err
    assert main(["report", "~nosuch/out"]) == 2
    assert "the home folder of an unknown user" in capsys.readouterr().err


# ---- features of somebody else under the key of ours


def test_features_of_another_kind_in_the_cache_are_extracted_again(bench: Bench) -> None:
    expected = bench.run(ONE)
    bench.calls()
    cache = FeatureCache(bench.root / "cache")
    files = sorted((bench.root / "cache").rglob("*.npz"))
    assert len(files) == 6
    for file in files:
        # Whole and valid, as anyone who may write into the folder can make them.
        assert cache.put(file.stem, {"image": [1, 2]}, 0.0)
    forget()
    done = bench.run(ONE, out="again")
    assert bits(done.rows) == bits(expected.rows)
    calls = bench.calls()
    assert (calls["image"], calls["cloud"]) == (3, 3)


# ---- the store


def test_a_disk_that_is_full_ends_the_study_and_keeps_its_rows(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The line under way is written in part; the next start has the finished rows and computes the others."""
    text = QUICK.replace("seeds = 2", "seeds = 20")
    write, lines = os.write, []

    def write_until_full(handle: int, data: bytes) -> int:
        if b'"key"' not in data:
            return write(handle, data)
        lines.append(data)
        return write(handle, data[:40] if len(lines) == 5 else data)

    monkeypatch.setattr(os, "write", write_until_full)
    with pytest.raises(InputError, match=r"tiny\.jsonl: the results cannot be written.*full.*free some space"):
        bench.run(text)
    monkeypatch.undo()
    assert len(list(Rows(bench.root / "out").each("tiny"))) == 4
    done = bench.run(text)
    assert done.computed == 60 - 4
    assert bits(done.rows) == bits(bench.run(text, out="alone").rows)


def test_a_full_disk_is_one_line_and_exit_2(bench: Bench) -> None:
    """A limit on the size of files is the only full disk that anyone can make."""
    text = QUICK.replace("seeds = 2", "seeds = 60")

    def small() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (25_000, 25_000))

    full = bench.cli(text, "--jobs", "1", "--quiet", preexec_fn=small)
    assert full.returncode == 2, full.stderr
    line = full.stderr.splitlines()[-1]
    assert line.startswith(f"p2o: error: {bench.root / 'out' / 'tiny.jsonl'}: the results cannot be written")
    kept = Rows(bench.root / "out").planned("tiny")
    assert 0 < len(kept) < 180
    done = bench.run(text)
    assert (len(done.rows), done.computed) == (180, 180 - len(kept))


@pytest.mark.parametrize("limit", [12, 14])
def test_too_few_open_files_are_one_line_that_names_the_limit_and_the_next_step(bench: Bench, limit: int) -> None:
    def few() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))

    ended = bench.cli(QUICK, "--jobs", "2", "--quiet", preexec_fn=few)
    assert ended.returncode == 2, ended.stderr
    [line] = [line for line in ended.stderr.splitlines() if not line.startswith("p2o: 0 rows")]
    assert line.startswith("p2o: error: ")
    assert f"Too many open files; this process may open {limit} files: raise the limit, e.g. `ulimit -n 1024`" in line


def test_a_lock_file_that_is_something_else_does_not_matter(bench: Bench) -> None:
    (bench.root / "out" / ".running").mkdir(parents=True)
    assert bench.run(QUICK).computed == 6


# ---- an end from outside


@pytest.fixture
def started(bench: Bench) -> Iterator[tuple[Bench, list[subprocess.Popen[str]]]]:
    """Yield the bench and a list of processes that are killed in the end."""
    processes: list[subprocess.Popen[str]] = []
    yield bench, processes
    for process in processes:
        process.kill()
        process.communicate()


SLOW = QUICK.replace("seeds = 2", "seeds = 200") + "options.calibrator.sleep_s = 0.1\n"


def alive(session: int) -> list[str]:
    """Return the processes of a session that still run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, own, *_ = stat.read_text().rpartition(")")[2].split()
        except (OSError, ValueError):
            continue
        if int(own) == session and state not in "ZX":
            found.append(stat.parent.name)
    return found


def gone(session: int) -> bool:
    """Return whether no process of a session is left, after a while."""
    until = time.monotonic() + 20
    while alive(session) and time.monotonic() < until:
        time.sleep(0.1)
    return not alive(session)


ENDS = {
    "one process, SIGTERM": ("1", signal.SIGTERM, os.kill),
    "two, SIGTERM": ("2", signal.SIGTERM, os.kill),
    "two, SIGTERM for all": ("2", signal.SIGTERM, os.killpg),
    "two, Ctrl-C": ("2", signal.SIGINT, os.killpg),
    "one, its terminal is closed": ("1", signal.SIGHUP, os.kill),
}


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("case", ENDS)
def test_a_study_that_is_told_to_end_keeps_its_rows_and_leaves_no_worker(
    started: tuple[Bench, list[subprocess.Popen[str]]], case: str
) -> None:
    bench, processes = started
    jobs, number, tell = ENDS[case]
    process = bench.started(SLOW, 3, "--jobs", jobs)
    processes.append(process)
    before = set(bench.keys())
    tell(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert out.startswith("Tiny\n"), "the table of what is there"
    assert set(bench.keys()) >= before
    assert gone(process.pid)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_workers_leave_when_the_study_is_killed(started: tuple[Bench, list[subprocess.Popen[str]]]) -> None:
    bench, processes = started
    process = bench.started(SLOW, 3, "--jobs", "2")
    processes.append(process)
    assert len(alive(process.pid)) >= 3
    process.kill()
    process.wait()
    assert gone(process.pid)


def test_a_second_request_to_end_while_the_first_is_obeyed_loses_nothing(
    started: tuple[Bench, list[subprocess.Popen[str]]],
) -> None:
    bench, processes = started
    process = bench.started(SLOW, 3, "--jobs", "2")
    processes.append(process)
    before = set(bench.keys())
    for _ in range(3):
        process.send_signal(signal.SIGTERM)
        time.sleep(0.02)
    process.communicate(timeout=60)
    assert process.returncode in (130, -signal.SIGTERM)
    assert set(bench.keys()) >= before
    assert gone(process.pid)


def test_an_error_of_the_system_is_one_line_with_the_next_step(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    put, finished = Rows.put, iter(range(2))

    def limited(rows: Rows, study: str, row: Row) -> None:
        if next(finished, None) is None:
            raise OSError(24, "Too many open files")
        put(rows, study, row)

    monkeypatch.setattr(Rows, "put", limited)
    assert main(bench.words(QUICK, "--jobs", "1", "--no-isolate", "--quiet")) == 2
    [error] = capsys.readouterr().err.splitlines()
    assert error.startswith("p2o: error: system: Too many open files; ")
    assert "`ulimit -n 1024`" in error
