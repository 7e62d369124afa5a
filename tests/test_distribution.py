"""Wheel, source archive and container carry what they need, and nothing that lies about."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = (
    "toolkit/p2o",
    "toolkit/p2o_study",
    "toolkit/p2o_train",
    "toolkit/p2o_testing",
    "toolkit/p2o_fleet",
    "toolkit/p2o_rig",
    "toolkit/p2o_pages",
    "plugins/p2o_plugins",
    "plugins/p2o_datasets",
    "plugins/p2o_formats",
    "plugins/p2o_sim",
    "baselines/p2o_baselines",
)


def built(source: Path, kind: str, folder: Path) -> Path:
    command = [sys.executable, "-m", "build", "-q", "--no-isolation", f"--{kind}", "--outdir", str(folder), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    [made] = folder.glob("p2o_calib-*.whl" if kind == "wheel" else "p2o_calib-*.tar.gz")
    return made


def copied() -> list[str]:
    """Return what the Containerfile copies into the image to install p2o from."""
    lines = re.findall(r"^COPY (.+) \S+$", (ROOT / "Containerfile").read_text(encoding="utf-8"), re.MULTILINE)
    return [word for line in lines for word in line.split()]


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source archive, unpacked."""
    folder = tmp_path_factory.mktemp("sdist")
    with tarfile.open(built(ROOT, "sdist", folder)) as held:
        held.extraction_filter = getattr(tarfile, "data_filter", None)  # Python 3.11.2 has no filters
        held.extractall(folder)
    [unpacked] = [path for path in folder.iterdir() if path.is_dir()]
    return unpacked


@pytest.fixture(scope="module")
def wheel(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from those files of the source archive only that the container gets."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in copied():
        source = archive / name
        if source.is_dir():
            shutil.copytree(source, folder / "source" / name)
        else:
            (folder / "source").mkdir(exist_ok=True)
            shutil.copy(source, folder / "source" / name)
    return built(folder / "source", "wheel", folder)


def test_the_wheel_holds_every_file_of_the_packages_and_nothing_else(wheel: Path) -> None:
    wanted = {
        path.relative_to((ROOT / package).parent).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(wheel) as held:
        names = {name for name in held.namelist() if ".dist-info/" not in name}
        about = {name.partition(".dist-info/")[2] for name in held.namelist()} - {""}
    assert names == wanted
    for name in (
        "p2o_plugins/weights/p2ornet-free.safetensors",
        "p2o_plugins/weights/MODEL_CARD.md",
        "p2o_baselines/studies/smoke.toml",
        "p2o_testing/plugin_template/slots/matcher.py.txt",
        "p2o/py.typed",
    ):
        assert name in names
    assert {"METADATA", "entry_points.txt", "licenses/LICENSE"} <= about


@pytest.mark.parametrize("name", ["docs", "tests", "benchmarks"])
def test_the_source_archive_holds_the_folders_that_docs_and_tests_need(archive: Path, name: str) -> None:
    def files(root: Path) -> set[str]:
        found = (path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())
        return {path for path in found if "__pycache__" not in path and "/." not in f"/{path}"}

    assert files(archive / name) == files(ROOT / name)


def test_the_source_archive_can_be_tested_and_documented(archive: Path) -> None:
    tools = ("pyproject.toml", "Makefile", "requirements.lock", "mkdocs.yml", "Containerfile")
    pages = ("README.md", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "THIRD_PARTY.md")
    for name in (*tools, *pages):
        assert (archive / name).read_bytes() == (ROOT / name).read_bytes()
    assert not (archive / "build").exists()


def test_the_container_runs_the_wheel_as_an_ordinary_user() -> None:
    lines = (ROOT / "Containerfile").read_text(encoding="utf-8").splitlines()
    said = [line for line in lines if line and not line.startswith("#")]
    stages = [number for number, line in enumerate(said) if line.startswith("FROM python:3.11-slim")]
    assert [said[number] for number in stages] == ["FROM python:3.11-slim AS wheel", "FROM python:3.11-slim"]
    image = said[stages[-1] :]
    assert not [line for line in image if line.startswith(("COPY", "ADD"))]
    [install] = [line for line in " ".join(image).split("RUN ") if "pip install" in line]
    assert "from=wheel,source=/wheel,target=/wheel" in install
    assert '"$file$EXTRAS"' in install
    [user] = [line for line in said if line.startswith("USER ")]
    assert user not in ("USER root", "USER 0")
    assert said.index(user) < said.index('ENTRYPOINT ["p2o"]')
    taken = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert taken == set(copied())


def test_every_locked_version_has_the_hashes_of_its_files_and_the_makefile_requires_them() -> None:
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8").replace("\\\n", " ")
    entries = [line.split() for line in lock.splitlines() if line.strip() and not line.startswith("#")]
    assert len(entries) > 50
    for requirement, *hashes in entries:
        assert re.fullmatch(r"[\w.-]+(\[[\w,-]+\])?==[\w.+!]+", requirement)
        assert hashes, requirement
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", text) for text in hashes), requirement
    # torch is the exception: its index determines the build.
    assert not [requirement for requirement, *_ in entries if requirement.startswith("torch==")]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    locked = [line for line in makefile.splitlines() if "requirements.lock" in line and "pip install" in line]
    assert len(locked) == 1
    assert {"--require-hashes", "--no-deps"} <= set(locked[0].split())
    others = [line for line in makefile.splitlines() if "pip install" in line and line not in locked]
    assert all("torch==" in line or "--no-deps" in line for line in others)
