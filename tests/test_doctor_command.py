"""`p2o doctor` finds out what an installation lacks, and what the main job cannot do without."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from p2o.cli import main
from p2o.host.registry import Broken, Registry
from p2o_testing.cli import doctor
from p2o_testing.cli.doctor import State


def found(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    status = main(["doctor", "--json", *words])
    return status, json.loads(capsys.readouterr().out)


def named(said: dict[str, Any], name: str) -> dict[str, str]:
    [finding] = [each for each in said["findings"] if each["name"] == name]
    return finding


def lacking(monkeypatch: pytest.MonkeyPatch, **versions: str | None) -> None:
    """Let packages have other versions, or none."""
    true = metadata.version

    def version(name: str) -> str:
        if name in versions:
            if versions[name] is None:
                raise metadata.PackageNotFoundError(name)
            return str(versions[name])
        return true(name)

    monkeypatch.setattr(metadata, "version", version)


def test_a_whole_installation_calibrates_and_ends_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert out.endswith("this installation works\n")
    assert "ok     self-check calibration: a synthetic street from 1deg 0.05m" in out
    assert "ok     files weights: weights of p2ornet read" in out
    assert "BAD" not in out


def test_json_holds_every_finding(capsys: pytest.CaptureFixture[str]) -> None:
    status, said = found(capsys, "--quick")
    assert status == 0
    assert said["ok"] is True
    groups = {each["group"] for each in said["findings"]}
    assert groups == {"machine", "dependencies", "extras", "files", "plugins"}
    assert {"python", "cores", "memory", "GPU", "numpy", "torch", "cache folder", "weights"} <= {
        each["name"] for each in said["findings"]
    }
    assert all(each["state"] in set(State) for each in said["findings"])
    assert all(each["advice"] for each in said["findings"] if each["state"] == "BAD")


@pytest.mark.parametrize(("version", "detail"), [(None, "not installed"), ("1.26.4", "1.26.4 does not satisfy >=2.0")])
def test_a_missing_or_old_dependency_fails_with_the_command_that_gets_it(
    version: str | None, detail: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lacking(monkeypatch, numpy=version, viser=None)
    status, said = found(capsys, "--quick")
    assert status == 1
    assert said["ok"] is False
    numpy = named(said, "numpy")
    assert numpy["state"] == "BAD"
    assert numpy["detail"] == detail
    assert numpy["advice"] == 'pip install "numpy>=2.0"'
    view = named(said, "view")
    assert (view["state"], view["advice"]) == ("absent", 'pip install "viser>=1.1"'), "a missing extra is no failure"


@pytest.mark.parametrize(("dist", "status"), [("acme-p2o", 0), ("p2o-calib", 1)])
def test_a_broken_plugin_is_told_with_its_reason_and_only_our_own_fails(
    dist: str, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = Registry.load()
    broken = Registry(whole.plugins, (Broken(dist, "1.0", "hooks", "ImportError: no module named acme"),))
    monkeypatch.setattr(Registry, "load", lambda **_: broken)
    ended, said = found(capsys, "--quick")
    assert ended == status
    finding = named(said, f"{dist}:hooks")
    assert finding["detail"] == "ImportError: no module named acme"
    assert dist in finding["advice"]


def test_a_broken_plugin_is_a_finding_where_others_make_it_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "acme_broken.py").write_text("raise RuntimeError('no licence server')\n")
    about = tmp_path / "acme_broken-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-broken\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[p2o]\nhooks = acme_broken\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("P2O_STRICT", "1")
    status, said = found(capsys, "--quick")
    assert status == 0
    assert named(said, "acme-broken:hooks")["detail"] == "RuntimeError: no licence server"


def test_a_cache_folder_that_cannot_be_written_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("P2O_CACHE", str(tmp_path / "file"))
    status, said = found(capsys, "--quick")
    assert status == 0  # a calibration alone needs none
    assert named(said, "cache folder")["state"] == "absent"
    assert "P2O_CACHE" in named(said, "cache folder")["advice"]


def test_weights_that_are_missing_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from p2o_plugins.p2ornet import shipped

    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    status, said = found(capsys, "--quick")
    assert status == 1
    assert named(said, "weights")["state"] == "BAD"
    assert "unknown weights 'free'" in named(said, "weights")["detail"]


def test_a_street_that_is_solved_wrongly_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "_NEAR_DEG", 0.0)
    assert main(["doctor"]) == 1
    assert capsys.readouterr().out.endswith("this installation does not work: self-check calibration\n")


def test_whatever_a_look_raises_ends_as_a_finding(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def gone(*_: object, **__: object) -> None:
        raise ImportError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr("p2o.host.guard.build", gone)
    status, said = found(capsys, "--quick")
    assert status == 1
    assert named(said, "weights")["detail"] == "ImportError: libGL.so.1: cannot open shared object file"
