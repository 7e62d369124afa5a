"""Fixtures of all tests: where the real frames are."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest

# The same examples each time, no files of them, and no stopwatch.
hypothesis.settings.register_profile("fixed", derandomize=True, database=None, deadline=None, max_examples=100)
hypothesis.settings.load_profile("fixed")

# Who starts tests in the background (nohup, a shell without jobs) has these ignored, and so would every command that a
# test starts and interrupts.
for _name in ("SIGINT", "SIGHUP"):
    if hasattr(signal, _name) and signal.getsignal(getattr(signal, _name)) is signal.SIG_IGN:
        signal.signal(getattr(signal, _name), signal.default_int_handler)

SYSTEM = {
    "tests/baselines/test_rivals.py",
    "tests/baselines/test_table1.py",
    "tests/benchmarks/test_kills.py",
    "tests/fuzz/test_contract.py",
    "tests/fuzz/test_fuzz.py",
    "tests/p2o_study/test_benchmark_bundle.py",
    "tests/p2o_study/test_smoke_poses.py",
    "tests/p2o_study/test_trouble.py",
    "tests/test_all_pages.py",
    "tests/test_benchmark_page_browser.py",
    "tests/test_data_show.py",
    "tests/test_distribution.py",
    "tests/test_docs_site.py",
    "tests/test_example_plugin.py",
    "tests/test_example_workflow.py",
    "tests/test_fleet_page.py",
    "tests/test_in_browser.py",
    "tests/test_notebook.py",
    "tests/test_pages.py",
    "tests/test_pick_page.py",
    "tests/test_real_accuracy.py",
    "tests/test_real_motion.py",
    "tests/test_report_page.py",
    "tests/test_rig_solve.py",
    "tests/test_ros_bag_page.py",
    "tests/test_run_page.py",
    "tests/test_tutorials.py",
    "tests/test_view_page.py",
}
"""Files of system tests: fuzzing, killed processes, browsers, lines of the docs, distributions, long studies."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import files without a test that `make test` or `make test-system` runs: all take half a minute."""
    kind = config.option.markexpr
    if kind not in ("system", "not system") or not collection_path.match("test_*.py"):
        return None
    system = collection_path.relative_to(Path(__file__).parents[1]).as_posix() in SYSTEM
    if kind == "not system":
        return system or None
    return None if system or "mark.system" in collection_path.read_text(encoding="utf-8") else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of `SYSTEM`, which `make test-system` runs; `make test` runs all others."""
    root = Path(__file__).parents[1]
    for item in items:
        if item.path.relative_to(root).as_posix() in SYSTEM:
            item.add_marker(pytest.mark.system)


@pytest.fixture(autouse=True)
def _numpy_error_state() -> Iterator[None]:
    """Fail the test that changes the floating-point error state of NumPy for all later ones."""
    before = np.geterr()
    yield
    after = np.seterr(**before)
    assert after == before


@pytest.fixture
def one_torch_thread() -> Iterator[None]:
    """Compute with one thread of PyTorch."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the variables that choose plugins and weights, or let errors of plugins raise."""
    for name in ("P2O_PLUGINS", "P2O_DEBUG", "P2O_STRICT", "P2O_WEIGHTS"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[[Sequence[str]], str]:
    """Return what runs a command that is to be refused, with status 2, no output and one line of error: the line."""
    from p2o.cli import main

    monkeypatch.setattr("p2o.cli.progress.LONG_WORK_S", 3600.0)  # no line of progress on a busy machine

    def line(words: Sequence[str]) -> str:
        capsys.readouterr()
        assert main([*words]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        [error] = captured.err.splitlines()
        assert error.startswith("p2o: error: ")
        return error

    return line


def pytest_configure(config: pytest.Config) -> None:
    """Make the folder of the synthetic frames of this run; workers inherit its name."""
    if not hasattr(config, "workerinput"):
        build = Path(__file__).parents[1] / "build"
        build.mkdir(exist_ok=True)
        os.environ["RENDERED_FRAMES"] = tempfile.mkdtemp(prefix="rendered-frames-", dir=build)


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove the folder, once all workers have ended."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ["RENDERED_FRAMES"], ignore_errors=True)


@pytest.fixture(autouse=True, scope="session")
def _synthetic_frames_are_rendered_once() -> Iterator[None]:
    from tests.rendered_frames import stored_in

    with stored_in(Path(os.environ["RENDERED_FRAMES"])):
        yield


DATA = Path(os.environ.get("P2O_DATA", Path(__file__).parents[1] / "build" / "data"))


@pytest.fixture(scope="session")
def kitti_raw() -> Path:
    """The root of the KITTI raw layout, or a skip that says how to get it."""
    root = DATA / "kitti_raw"
    if not root.is_dir():
        pytest.skip(f"no real frames in {root}: set P2O_DATA (see docs/datasets.md)")
    return root


@pytest.fixture(scope="session")
def real_data(kitti_raw: Path) -> Path:
    """The folder of all real frames, of other rigs, too, where they are."""
    return kitti_raw.parent


@pytest.fixture(scope="session")
def kitti_object() -> Path:
    """The root of the KITTI object layout, or a skip that says how to get it."""
    root = DATA / "kitti_object"
    if not root.is_dir():
        pytest.skip(f"no real frames in {root}: set P2O_DATA (see docs/datasets.md)")
    return root


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless Chromium, or a skip that says how to get one."""
    pytest.importorskip("selenium", reason="selenium is not installed")
    from tests.in_browser import chromium

    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver
