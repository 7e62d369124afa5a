"""The commands of docs/how-to/fleet.md, on a dask cluster of local processes, and the page of a fleet in a browser."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from kills import write_drives
from p2o.cli import main
from p2o.host.calibration_file import read_extrinsic_file
from p2o.host.registry import Registry
from p2o_fleet.evidence import COLUMNS
from p2o_fleet.fleet_state import fleet_state
from p2o_fleet.page import write_page
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, simulated_fleet, write_fleet
from p2o_fleet.store import Store

from tests.pages import ROOT, blocks, shell_blocks

PAGE = "docs/how-to/fleet.md"
QUICK = ("--frames", "1", "--candidates", "1", "--extractor", "depth/rings", "--json")
NEEDS_DASK = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason='needs pip install ".[dask]"')


def _compose() -> str:
    [compose] = [block.text for block in blocks(PAGE) if block.language == "yaml"]
    return compose


def _services() -> dict[str, Any]:
    services: dict[str, Any] = yaml.safe_load(_compose())["services"]
    return services


def test_the_compose_file_builds_the_image_of_this_project_with_extras_that_exist() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    image = (ROOT / "Containerfile").read_text()
    for service in _services().values():
        assert (ROOT / service["build"]["context"] / service["build"]["dockerfile"]).is_file()
        [(name, value)] = service["build"]["args"].items()
        assert f"ARG {name}=" in image
        assert set(value.strip("[]").split(",")) <= extras.keys()
        assert {"fleet", "dask"} <= set(value.strip("[]").split(","))
        assert service.keys() <= {"build", "entrypoint", "command", "ports", "volumes", "depends_on"}
        assert all(re.fullmatch(r"/\w+:/\w+:ro", volume) for volume in service.get("volumes", ()))


@NEEDS_DASK
def test_the_commands_of_the_compose_file_exist_and_belong_together() -> None:
    from p2o_fleet.cli.fleet import run

    services = _services()
    parsed = {}
    for name, service in services.items():
        program, command, *words = service["entrypoint"]
        assert (program, command, service["command"]) == ("dask", name, [])
        main = importlib.import_module(f"distributed.cli.dask_{name}").main
        parsed[name] = main.make_context(name, words).params
    port = int(parsed["scheduler"]["port"])
    assert services["scheduler"]["ports"] == [f"{port}:{port}"]
    assert parsed["worker"]["scheduler"] == f"tcp://scheduler:{port}"
    assert services["worker"]["depends_on"] == ["scheduler"]
    start, client = re.fullmatch(r"# (docker compose .*), then: (.*)", _compose().splitlines()[0]).groups()  # type: ignore[union-attr]
    assert start.split()[-1].partition("=")[0] in services
    words = ["drives.csv" if word == "..." else word for word in client.split()[3:]]
    assert client.startswith("p2o fleet run ")
    assert run.make_context("run", words).params["address"] == f"tcp://localhost:{port}"


def test_the_lines_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_drives(tmp_path, 5)
    commands = [command for block in shell_blocks(PAGE) for command in block.commands()]
    words = [command.words for command in commands if command.text.startswith("p2o fleet")]
    assert [each[2] for each in words] == ["run", "report", "run", "simulate", "report"]
    assert main([*words[0][1:], *QUICK]) == 0
    assert json.loads(capsys.readouterr().out)["checked"] == 5
    assert main(words[1][1:]) == 0
    assert main(words[3][1:]) == 0
    capsys.readouterr()
    assert main(words[4][1:]) == 1
    assert "slipped" in capsys.readouterr().out
    report = tmp_path / "simulated-report"
    assert sorted(path.name for path in report.iterdir()) == ["data", "fleet.json", "index.html"]
    [proposal, *_] = [alarm["proposal"] for alarm in json.loads((report / "fleet.json").read_text())["alarms"]]
    (tmp_path / "van.txt").write_text("\n".join(" ".join(map(str, row)) for row in proposal))
    read_extrinsic_file("van.txt", "--extrinsic", registry=Registry.load(environ={}))


def test_the_page_names_every_column_of_the_store() -> None:
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    table = text.partition("\n## Store\n")[2]
    assert {name for name in COLUMNS if f"`{name}`" not in table} == set()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Start the commands of the compose file as local processes: a scheduler and two workers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address, services = f"tcp://127.0.0.1:{port}", _services()
    scheduler = [*services["scheduler"]["entrypoint"][1:], "--host", "127.0.0.1", "--no-dashboard"]
    worker = [*services["worker"]["entrypoint"][1:], "--no-dashboard", "--local-directory", str(tmp_path / "dask")]
    assert (scheduler[0], worker[0]) == ("scheduler", "worker")
    commands = [[str(port) if word == "8786" else word for word in scheduler]]
    commands += [[address if word.startswith("tcp://") else word for word in worker]] * 2
    modules = {"scheduler": "distributed.cli.dask_scheduler", "worker": "distributed.cli.dask_worker"}
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", modules[command[0]], *command[1:]],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        for command in commands
    ]
    try:
        yield address, processes
    finally:
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@NEEDS_DASK
def test_a_dask_cluster_that_loses_a_worker_and_its_scheduler_loses_no_check(
    tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]]
) -> None:
    address, (scheduler, first, _) = cluster
    table, store = write_drives(tmp_path / "drives", 40), tmp_path / "store"
    command = [sys.executable, "-m", "p2o", "fleet", "run", str(table), "--store", str(store), *QUICK]
    process = subprocess.Popen(
        [*command, "--backend", "dask", "--address", address], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    _until(process, store, 5)
    os.killpg(first.pid, signal.SIGKILL)
    _until(process, store, 15)
    before = _keys(store)
    os.killpg(scheduler.pid, signal.SIGKILL)
    _, error = process.communicate(timeout=240)
    assert process.returncode == 2, error
    assert len(error.decode().splitlines()) == 1
    assert b"finished rows are kept" in error
    assert before <= _keys(store)
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    counts = json.loads(done.stdout)
    assert counts["checked"] + counts["kept"] == 40
    assert counts["kept"] >= 15
    assert len(_keys(store)) == 40


def _until(process: subprocess.Popen[bytes], store: Path, count: int) -> None:
    until = time.monotonic() + 240
    while process.poll() is None and time.monotonic() < until and len(_keys(store)) < count:
        time.sleep(0.1)
    assert process.poll() is None, process.communicate()[1]


def _keys(store: Path) -> set[str]:
    if not (store / "checks").exists():
        return set()
    return {str(key) for checks in Store(store).checks() for key in checks.texts["key"]}


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason='needs pip install ".[ray]"')
def test_ray_checks_every_drive_once(tmp_path: Path) -> None:
    table, store = write_drives(tmp_path / "drives", 10), tmp_path / "store"
    command = [sys.executable, "-m", "p2o", "fleet", "run", str(table), "--store", str(store), *QUICK]
    done = subprocess.run([*command, "--backend", "ray", "--jobs", "2"], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["checked"] == len(_keys(store)) == 10


def test_two_runs_at_the_same_time_store_every_drive_once(tmp_path: Path) -> None:
    table, store = write_drives(tmp_path / "drives", 20), tmp_path / "store"
    command = [sys.executable, "-m", "p2o", "fleet", "run", str(table), "--store", str(store), *QUICK]
    runs = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    counts = [json.loads(run.communicate(timeout=240)[0]) for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    assert all(count["checked"] + count["kept"] == 20 for count in counts)
    assert {checks.vehicle: len(checks) for checks in Store(store).checks()} == {f"van-{n}": 4 for n in range(5)}
    assert not list((store / "journal").iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="the size of files cannot be limited")
def test_a_run_that_cannot_write_ends_with_one_line_and_the_next_one_continues(tmp_path: Path) -> None:
    import resource

    table, store = write_drives(tmp_path / "drives", 12), tmp_path / "store"
    command = [sys.executable, "-m", "p2o", "fleet", "run", str(table), "--store", str(store), *QUICK]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
    )
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "File too large" in done.stderr
    before = _keys(store)
    assert 0 < len(before) < 12, "checks that fit are stored, the next one is not"
    counts = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert counts["kept"] == len(before)
    assert before < _keys(store)
    assert sum(len(checks) for checks in Store(store).checks()) == 12


_DIES = """
import os, signal
import p2o

class Options(p2o.Options):
    root: str = p2o.field("", help="Nothing.")

def build(options: Options) -> p2o.Dataset:
    os.kill(os.getpid(), signal.SIGKILL)

@p2o.hookimpl
def p2o_datasets():
    yield p2o.Method(name="dies", build=build, options=Options, summary="Kills its process.")
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs signals")
def test_a_drive_that_kills_its_worker_is_a_row_with_the_reason_and_the_others_are_checked(tmp_path: Path) -> None:
    table, store, plugin = write_drives(tmp_path / "drives", 6), tmp_path / "store", tmp_path / "dies.py"
    plugin.write_text(_DIES)
    with table.open("a") as file:
        file.write("van-9,front,top,dies:nothing,truth,1767225600\n")
    command = [sys.executable, "-m", "p2o", "fleet", "run", str(table), "--store", str(store), *QUICK]
    done = subprocess.run(
        [*command, "--jobs", "2", "--plugin", str(plugin)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    counts = json.loads(done.stdout)
    assert (counts["checked"], counts["unreadable"]) == (7, 1)
    [lost] = Store(store).checks(["van-9"])
    assert "the worker process died" in lost.texts["reason"][0]


def test_the_page_of_three_hundred_vehicles_filters_searches_and_shows_histories(tmp_path: Path) -> None:
    pytest.importorskip("selenium", reason="selenium is not installed")
    from tests.in_browser import Page, chromium

    shares = {Fault.SLIP: 0.05, Fault.SWAPPED: 0.02}
    store = Store(tmp_path / "store")
    write_fleet(simulated_fleet(Scenario(300, 24, shares=shares), NoiseBank.shipped()), store)
    state = fleet_state(store)
    index = write_page(state, tmp_path / "report")
    assert index.stat().st_size < 600_000
    with chromium(tmp_path / "profile") as driver:
        page = Page(driver, index)
        page.until_equal(lambda: page.text("#rows-count"), "300 of 300 extrinsics")
        assert page.count("#rows tbody tr") == 200
        page.click('.tile[data-value="slipped"]')
        slipped = sum(one.status.value == "slipped" for one in state.current)
        assert slipped > 5
        page.until_equal(lambda: page.text("#rows-count"), f"{slipped} of 300 extrinsics")
        assert set(page.column("rows", "state")) == {"slipped"}
        page.click('.tile[data-value="slipped"]')
        page.write("#rows-find", "vehicle-0012", value="vehicle-0012")
        page.until_equal(lambda: page.text("#rows-count"), "10 of 300 extrinsics")
        page.sort("rows", "vehicle")
        page.click("#rows tbody tr td")
        page.until_equal(lambda: page.text("#detail-title"), "vehicle-00120: front and top")
        page.until_equal(lambda: page.count("#detail .plot svg"), 7)
        assert page.count("#detail .plot .point") >= 6 * 20
        page.click("#close")
        assert page.complaints("SEVERE") == []
        assert [url for url in page.requests() if not re.match(r"file:.*/report/data/history-\d+\.js", url)] == []
