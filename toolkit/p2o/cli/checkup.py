"""What this machine has of what p2o needs, found out one by one: what `p2o doctor` shows."""

from __future__ import annotations

import contextlib
import io
import os
import platform
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib import metadata
from typing import TYPE_CHECKING

from p2o.errors import InputError, P2OError, one_line

if TYPE_CHECKING:
    from p2o.host.registry import Registry

DISTRIBUTION = "p2o-calib"
_LEAST_MEMORY_GIB = 2.0
_SELF_CHECK = "synthetic:?scenes=1&width_px=621&height_px=188"
_START = "1deg 0.05m"
_NEAR_DEG, _NEAR_M = 0.3, 0.1


class State(StrEnum):
    """How it stands with a thing: BAD is what the main job needs and does not have."""

    OK = "ok"
    ABSENT = "absent"
    BAD = "BAD"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: `detail` says what was found, `advice` what to do where something is amiss."""

    group: str
    name: str
    state: State
    detail: str
    advice: str = ""


def findings(*, self_check: bool = True) -> Iterator[Finding]:
    """Look at one thing after the other; whatever an installation lacks ends as a finding, never as an exception."""
    looks: list[tuple[str, str, Callable[[], Iterator[Finding]]]] = [
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
            yield from look()
        except Exception as problem:
            kind = "" if isinstance(problem, P2OError) else f"{type(problem).__name__}: "
            yield Finding(group, name, State.BAD, kind + one_line(problem, 300), _REINSTALL)


_REINSTALL = f"install it anew: pip install --force-reinstall {DISTRIBUTION}"


def _machine() -> Iterator[Finding]:
    version = platform.python_version()
    old = sys.version_info < (3, 11)
    yield Finding("machine", "python", State.BAD if old else State.OK, version, "Python 3.11 or later" if old else "")
    yield Finding("machine", "p2o", State.OK, _version(DISTRIBUTION) or "not installed, run from its sources")
    yield Finding("machine", "platform", State.OK, platform.platform())
    free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Finding("machine", "cores", State.OK, f"{free} of {os.cpu_count()}")
    memory_gib = _memory_gib()
    if memory_gib is None:
        yield Finding("machine", "memory", State.OK, "unknown on this platform")
    else:
        few = memory_gib < _LEAST_MEMORY_GIB
        advice = f"{_LEAST_MEMORY_GIB:g} GiB or more are wanted" if few else ""
        yield Finding("machine", "memory", State.BAD if few else State.OK, f"{memory_gib:.1f} GiB", advice)


def _memory_gib() -> float | None:
    """Return the memory of the machine, or of the container where that is less."""
    try:
        size = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return None
    with contextlib.suppress(OSError, ValueError), open("/sys/fs/cgroup/memory.max", encoding="ascii") as file:
        size = min(size, float(file.read()))
    return size / 2**30


def _dependencies() -> Iterator[Finding]:
    for required in _required(""):
        yield _package("dependencies", required, State.BAD)


def _extras() -> Iterator[Finding]:
    """Each extra, present where all of its packages are; those that only authors of p2o need are left out."""
    for extra in metadata.metadata(DISTRIBUTION).get_all("Provides-Extra") or []:
        if extra in ("dev", "docs"):
            continue
        packages = {required: _package("extras", required, State.ABSENT) for required in _required(extra)}
        missing = {required: each for required, each in packages.items() if each.state is not State.OK}
        detail = ", ".join(f"{each.name} {each.detail}" for each in (missing or packages).values())
        # The packages, not the extra: p2o itself may be on no index.
        advice = "pip install " + " ".join(f'"{required}"' for required in missing) if missing else ""
        yield Finding("extras", extra, State.ABSENT if missing else State.OK, detail, advice)


def _package(group: str, required: str, lacking: State) -> Finding:
    name, least = _parsed(required)
    found = _version(name)
    if found is None:
        return Finding(group, name, lacking, "not installed", f'pip install "{required}"')
    if least and _numbers(found) < _numbers(least):
        return Finding(group, name, lacking, f"{found} is too old", f'pip install "{required}"')
    return Finding(group, name, State.OK, found)


def _required(extra: str) -> list[str]:
    """Return the requirements of an extra, or of p2o itself for ""."""
    found = []
    for text in metadata.requires(DISTRIBUTION) or []:
        required, _, marker = text.partition(";")
        of_extra = re.search(r"""extra\s*==\s*['"]([^'"]+)['"]""", marker)
        if (of_extra[1] if of_extra else "") == extra:
            found.append(required.strip())
    return found


def _parsed(required: str) -> tuple[str, str]:
    """Return the name of a requirement and the least version it takes, "" for any."""
    name = re.match(r"[\w.-]+", required)
    least = re.search(r">=\s*([\d.]+)", required)
    return name[0] if name else required, least[1] if least else ""


def _numbers(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version, without zeros at the end: 2.0 is 2."""
    numbers = [int(part) for part in re.split(r"[^\d.]", version)[0].split(".") if part]
    while numbers and not numbers[-1]:
        numbers.pop()
    return tuple(numbers)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _gpu() -> Iterator[Finding]:
    import torch

    if torch.cuda.is_available():
        yield Finding("machine", "GPU", State.OK, torch.cuda.get_device_name())
    else:
        yield Finding("machine", "GPU", State.ABSENT, "none that PyTorch sees; calibrations need none, trainings gain")


def _cache() -> Iterator[Finding]:
    from p2o.work.cache import cache_folder

    folder = cache_folder()
    probe = folder / f".p2o-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as problem:
        advice = "set P2O_CACHE to a folder that can be written; studies keep there what they extract"
        yield Finding("files", "cache folder", State.ABSENT, f"{folder}: {problem.strerror or problem}", advice)
    else:
        yield Finding("files", "cache folder", State.OK, str(folder))


def _plugins() -> Iterator[Finding]:
    registry = _registry()
    for plugin in registry.plugins:
        version = f" {plugin.version}" if plugin.version else ""
        yield Finding("plugins", plugin.name, State.OK, f"{len(plugin.offers)} methods{version}")
    for broken in registry.broken:
        own = broken.dist == DISTRIBUTION
        advice = _REINSTALL if own else f"leave it out with --block {broken.dist}, or install it anew"
        yield Finding("plugins", broken.name, State.BAD if own else State.ABSENT, broken.error, advice)


def _registry() -> Registry:
    """Return what is installed, without a word on stderr: broken plugins are findings here, and never errors."""
    from p2o.host.registry import Registry

    environ = {name: value for name, value in os.environ.items() if name != "P2O_STRICT"}
    with contextlib.redirect_stderr(io.StringIO()):
        return Registry.load(environ=environ)


def _weights() -> Iterator[Finding]:
    """The default image extractor is built and looks at an image: its weights are read for that."""
    from p2o.host.guard import build
    from p2o.host.method import Kind
    from p2o.run.recipe import Recipe
    from p2o.testing import stage

    name = str(Recipe.model_fields["extractor"].default).partition("/")[0]
    offer = _registry().find(Kind.IMAGE_EXTRACTOR, name)
    found = build(offer, offer.method.options())(stage.frame().image)
    yield Finding("files", "weights", State.OK, f"those of {name} are read, {len(found.edges)} edges on a test picture")


def _calibration() -> Iterator[Finding]:
    """The default methods calibrate a small synthetic street and come near its exact truth."""
    from p2o.run.run import calibrate

    [row] = calibrate(_SELF_CHECK, perturb=_START, registry=_registry()).rows
    status, error = row.result.status, row.error
    if error is None or not status.solved:
        raise InputError(f"the built-in street is not solved: {status.value}", got=row.result.reason)
    ended = f"{error.rotation_deg:.2f} deg and {error.translation_m:.3f} m from the truth"
    near = error.rotation_deg <= _NEAR_DEG and error.translation_m <= _NEAR_M
    yield Finding(
        "self-check",
        "calibration",
        State.OK if near else State.BAD,
        f"a synthetic street from {_START}: {ended}",
        "" if near else f"{_NEAR_DEG:g} deg and {_NEAR_M:g} m are expected; p2o methods shows what is used, report it",
    )
