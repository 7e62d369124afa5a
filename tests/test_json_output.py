"""--json: one object on standard output whatever else is written to it, and failures of plugins in one line."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from p2o.cli import group, main
from p2o.cli.json_output import print_json, reserved_stdout
from p2o.host.registry import file_module_name

from tests.noisy_plugin import NOISE

PLUGIN = Path(__file__).with_name("noisy_plugin.py")
RUN = ("run", "synthetic:?scenes=2&width_px=64&height_px=64&lidar=vlp-16&right=false", "--calibrator", "noisy")
FORK_ENDED = "p2o: warning: ended a process that a plugin had forked and that returned from its call"
pytestmark = pytest.mark.usefixtures("plain_environment")


def words(*more: str) -> list[str]:
    return [*more, "--plugin", str(PLUGIN), "--json"]


def errors(err: str) -> list[str]:
    """Return the lines of standard error without the noise of the plugin."""
    return [line for line in err.splitlines() if line != NOISE]


@pytest.mark.parametrize("isolate", [(), ("--isolate",)])
def test_a_run_prints_one_object_whatever_a_plugin_writes(
    isolate: tuple[str, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(words(*RUN, "--frames", "0", "--witness", "none", *isolate)) == 0
    out, err = capfd.readouterr()
    print("after")
    assert capfd.readouterr().out == "after\n"
    assert out.count("\n") == 1
    assert set(json.loads(out)) == {"results", "failed", "summary"}
    assert errors(err) == []
    assert NOISE in err


def test_processes_that_a_plugin_forks_print_nothing_and_end() -> None:
    """One child returns from its call, the other raises."""
    command = [sys.executable, "-m", "p2o", *words(*RUN, "--witness", "none")]
    environment = {**os.environ, "NOISY_MODE": "fork"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    assert len(json.loads(done.stdout)["results"]) == 2
    assert errors(done.stderr) == [FORK_ENDED] * 2


@pytest.mark.parametrize(
    ("mode", "more", "status", "message"),
    [
        ("textless", (), 2, "calibrator 'noisy' raised TextlessError while calibrating; got no text, because"),
        ("textless-import", (), 2, "cannot load plugin noisy_plugin.py:noisy_plugin; got TextlessError: no text"),
        ("interrupt", (), 2, "calibrator 'noisy' raised KeyboardInterrupt while calibrating"),
        ("interrupt-import", (), 2, "cannot load plugin noisy_plugin.py:noisy_plugin; got KeyboardInterrupt"),
        ("interrupt", ("--isolate",), 2, "calibrator 'noisy' raised KeyboardInterrupt while calibrating"),
    ],
)
def test_failures_of_plugins_are_one_line(
    mode: str, more: tuple[str, ...], status: int, message: str, capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setenv("NOISY_MODE", mode)
    monkeypatch.setenv("P2O_STRICT", "1")
    monkeypatch.delitem(sys.modules, file_module_name(PLUGIN), raising=False)
    assert main(words(*RUN, "--frames", "0", "--witness", "none", *more)) == status
    out, err = capfd.readouterr()
    [line] = errors(err)
    assert message in line
    assert NOISE not in out


def test_fleet_prints_one_object_whatever_its_workers_write(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyarrow")
    from kills import write_drives

    fleet = ("fleet", "run", str(write_drives(tmp_path / "drives", 2)), "--store", str(tmp_path / "store"))
    options = ("--frames", "1", "--candidates", "1", "--extractor", "depth/rings", "--jobs", "2")
    assert main(words(*fleet, *options)) == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["checked"] == 2, err
    assert NOISE in err


def test_every_command_with_json_reserves_standard_output() -> None:
    """The mechanism is that of the option: no command prints its object without it."""

    def commands(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
        if not isinstance(command, click.Group):
            yield name, command
            return
        context = click.Context(command)
        for each in command.list_commands(context):
            if (inner := command.get_command(context, each)) is not None:
                yield from commands(inner, f"{name} {each}")

    with_json = {n: c for n, c in commands(group, "p2o") if any("--json" in each.opts for each in c.params)}
    assert {"p2o run", "p2o check", "p2o compare", "p2o fleet run", "p2o fleet report", "p2o rig"} <= set(with_json)
    for name, command in with_json.items():
        assert "print_json(" in inspect.getsource(inspect.unwrap(command.callback)), name


def test_python_code_gets_standard_output_back(capfd: pytest.CaptureFixture[str]) -> None:
    with reserved_stdout(restored=True):
        os.write(1, b"noise")
        print("noise")
        print_json({"a": 1})
    print("after")
    assert capfd.readouterr().out == '{"a": 1}\nafter\n'
