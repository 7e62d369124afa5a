"""`p2o doctor`: check the requirements of p2o on this machine."""

from __future__ import annotations

import contextlib
import io
import math
import os
import platform
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from enum import StrEnum
from importlib import metadata
from typing import TYPE_CHECKING

import click
from p2o.cli.json_output import json_option, print_json
from p2o.errors import InputError, P2OError, one_line
from p2o.host.registry import DISTRIBUTION, Registry, requirements
from p2o.runtime.native import available_cores

if TYPE_CHECKING:
    from packaging.requirements import Requirement

_REINSTALL = f"reinstall it: pip install --force-reinstall {DISTRIBUTION}"
_LEAST_MEMORY_GIB = 2.0
_SELF_CHECK = "synthetic:?scenes=1&width_px=621&height_px=188"
_START = "1deg 0.05m"
_NEAR_DEG, _NEAR_M = 0.3, 0.1


class State(StrEnum):
    """The state of a requirement: ABSENT is optional, BAD is needed for calibrations."""

    OK = "ok"
    ABSENT = "absent"
    BAD = "BAD"


@dataclass(frozen=True)
class Finding:
    """The outcome of one check with `detail`, and `advice` if something is missing."""

    group: str
    name: str
    state: State
    detail: str
    advice: str = ""


_Outcome = tuple[str, State, str] | tuple[str, State, str, str]
"""Name, state, detail and, if something is missing, advice of a check."""


@click.command("doctor")
@json_option
@click.option(
    "--quick", is_flag=True, help="Leave out the calibration of a small synthetic street, which takes some seconds."
)
def command(as_json: bool, quick: bool) -> int:
    """Check whether this installation works, and print what is missing and how to install it.

    Checks Python, machine, packages, extras, GPU, cache folder, plugins, weights, and a calibration with ground truth.
    Exit status 0 if calibrations work, 1 otherwise; missing extras are no failure.
    """
    results: list[Finding] = []
    for finding in findings(self_check=not quick):
        results.append(finding)
        if not as_json:
            click.echo(f"{finding.state:<7}" + one_line(f"{finding.group} {finding.name}: {finding.detail}"))
            if finding.advice:
                click.echo(f"{'':7}{finding.advice}")
    bad = [finding for finding in results if finding.state is State.BAD]
    if as_json:
        print_json({"ok": not bad, "findings": [asdict(each) for each in results]})
    else:
        names = ", ".join(f"{each.group} {each.name}" for each in bad)
        click.echo(f"\nthis installation does not work: {names}" if bad else "\nthis installation works")
    return 1 if bad else 0


def findings(*, self_check: bool = True) -> Iterator[Finding]:
    """Run all checks; every fault of an installation is a finding, never an exception."""
    looks: list[tuple[str, str, Callable[[], Iterator[_Outcome]]]] = [
        ("machine", "machine", _machine),
        ("dependencies", "dependencies", _dependencies),
        ("extras", "extras", _extras),
        ("machine", "GPU", _gpu),
        ("files", "cache folder", _cache),
        ("plugins", "plugins", _plugins),
        ("files", "weights", _weights),
    ]
    if self_check:
        looks.append(("self-check", "calibration", _calibration))
    for group, name, look in looks:
        try:
            yield from (Finding(group, *outcome) for outcome in look())
        except Exception as problem:
            kind = "" if isinstance(problem, P2OError) else f"{type(problem).__name__}: "
            yield Finding(group, name, State.BAD, kind + one_line(problem, 300), _REINSTALL)


def _machine() -> Iterator[_Outcome]:
    version = platform.python_version()
    old = sys.version_info < (3, 11)
    yield ("python", State.BAD if old else State.OK, version, "Python 3.11 or later" if old else "")
    yield ("p2o", State.OK, _version(DISTRIBUTION) or "not installed, run from its sources")
    yield ("platform", State.OK, platform.platform())
    yield ("cores", State.OK, f"{available_cores()} of {os.cpu_count()}")
    memory_gib = _memory_gib()
    few = memory_gib < _LEAST_MEMORY_GIB
    detail = f"{memory_gib:.1f} GiB" if math.isfinite(memory_gib) else "unknown on this platform"
    advice = f"{_LEAST_MEMORY_GIB:g} GiB or more are recommended" if few else ""
    yield ("memory", State.BAD if few else State.OK, detail, advice)


def _memory_gib() -> float:
    """Return the memory of the machine or the limit of the container in GiB, whichever is less; inf if unknown."""
    size = math.inf
    with contextlib.suppress(AttributeError, ValueError, OSError):
        size = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(OSError, ValueError), open("/sys/fs/cgroup/memory.max", encoding="ascii") as file:
        size = min(size, float(file.read()))
    return size / 2**30


def _dependencies() -> Iterator[_Outcome]:
    yield from (_package(required, State.BAD) for required in requirements(DISTRIBUTION))


def _extras() -> Iterator[_Outcome]:
    """Check that all packages of each extra are installed, except for extras for developers."""
    for extra in metadata.metadata(DISTRIBUTION).get_all("Provides-Extra") or []:
        if extra in ("dev", "docs"):
            continue
        packages = {required: _package(required, State.ABSENT) for required in requirements(DISTRIBUTION, extra)}
        missing = {required: each for required, each in packages.items() if each[1] is not State.OK}
        detail = ", ".join(f"{each[0]} {each[2]}" for each in (missing or packages).values())
        # The packages instead of the extra, because p2o may not be on a package index.
        advice = "pip install " + " ".join(f'"{required}"' for required in missing) if missing else ""
        yield (extra, State.ABSENT if missing else State.OK, detail, advice)


def _package(required: Requirement, lacking: State) -> _Outcome:
    version = _version(required.name)
    advice = f'pip install "{required}"'
    if version is None:
        return (required.name, lacking, "not installed", advice)
    if not required.specifier.contains(version, prereleases=True):
        return (required.name, lacking, f"{version} does not satisfy {required.specifier}", advice)
    return (required.name, State.OK, version)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _gpu() -> Iterator[_Outcome]:
    absent = "not looked for without PyTorch"
    with contextlib.suppress(ModuleNotFoundError):
        import torch

        if torch.cuda.is_available():
            yield ("GPU", State.OK, torch.cuda.get_device_name())
            return
        absent = "none found by PyTorch"
    yield "GPU", State.ABSENT, f"{absent}; not needed for calibrations, useful for trainings"


def _cache() -> Iterator[_Outcome]:
    from p2o.cache import cache_folder
    from p2o.files.whole_file import make_writable

    folder = cache_folder()
    try:
        make_writable(folder)
    except OSError as problem:
        advice = "set P2O_CACHE to a writable folder, in which studies cache features"
        yield ("cache folder", State.ABSENT, f"{folder}: {problem.strerror or problem}", advice)
    else:
        yield ("cache folder", State.OK, str(folder))


def _plugins() -> Iterator[_Outcome]:
    registry = _registry()
    for plugin in registry.plugins:
        version = f" {plugin.version}" if plugin.version else ""
        yield (plugin.name, State.OK, f"{len(plugin.offers)} methods{version}")
    for broken in registry.broken:
        own = broken.dist == DISTRIBUTION
        advice = _REINSTALL if own else f"leave it out with --block {broken.dist}, or reinstall it"
        yield (broken.name, State.BAD if own else State.ABSENT, broken.error, advice)


def _registry() -> Registry:
    """Return the installed plugins without messages on stderr: broken plugins are findings here, not errors."""
    environ = {name: value for name, value in os.environ.items() if name != "P2O_STRICT"}
    with contextlib.redirect_stderr(io.StringIO()):
        return Registry.load(environ=environ)


def _weights() -> Iterator[_Outcome]:
    """Build the default image extractor and run it on an image, which reads its weights."""
    from p2o.host.guard import build
    from p2o.host.method import Kind
    from p2o.run.recipe import Recipe

    from p2o_testing import stage

    name = str(Recipe.model_fields["extractor"].default).partition("/")[0]
    offer = _registry().find(Kind.IMAGE_EXTRACTOR, name)
    features = build(offer, offer.method.options())(stage.frame().image)
    yield ("weights", State.OK, f"weights of {name} read, {len(features.edges)} edges on a test image")


def _calibration() -> Iterator[_Outcome]:
    """Calibrate a small synthetic street with the default methods and compare with the ground truth."""
    from p2o.run.run import calibrate

    [row] = calibrate(_SELF_CHECK, perturb=_START, registry=_registry()).rows
    status, error = row.result.status, row.error
    if error is None or not status.solved:
        raise InputError(f"the calibration of the built-in street was refused: {status.value}", got=row.result.reason)
    near = error.rotation_deg <= _NEAR_DEG and error.translation_m <= _NEAR_M
    wanted = f"{_NEAR_DEG:g} deg and {_NEAR_M:g} m are expected; report this with the output of p2o methods"
    text = f"a synthetic street from {_START}: error {error.rotation_deg:.2f} deg and {error.translation_m:.3f} m"
    yield ("calibration", State.OK, text) if near else ("calibration", State.BAD, text, wanted)
