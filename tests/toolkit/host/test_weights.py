"""Weights by name: shipped ones, those of installed packages with the licence of their metadata, and files."""

from __future__ import annotations

from pathlib import Path

import pytest
from p2o import UnknownNameError
from p2o.reading import weights_of


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed package of weights whose code must not run."""
    site = tmp_path / "site"
    folder, about = site / "acme_weights", site / "acme_weights-1.0.dist-info"
    folder.mkdir(parents=True)
    about.mkdir()
    (folder / "__init__.py").write_text("raise SystemExit('imported')")
    (folder / "net-acme.safetensors").write_bytes(b"acme")
    (about / "METADATA").write_text(
        "Metadata-Version: 2.4\nName: acme-weights\nVersion: 1.0\nLicense-Expression: MIT\n"
    )
    (about / "entry_points.txt").write_text("[p2o.weights]\nacme = acme_weights\n")
    monkeypatch.syspath_prepend(str(site))
    return folder


def test_a_package_adds_weights_with_its_licence_and_is_not_imported(package: Path, tmp_path: Path) -> None:
    shipped = tmp_path / "own"
    shipped.mkdir()
    (shipped / "net-free.safetensors").write_bytes(b"free")
    free, acme = (weights_of("net", name, shipped, "Apache-2.0") for name in ("free", "acme"))
    assert (free.path, free.licence) == (shipped / "net-free.safetensors", "free: Apache-2.0")
    assert (acme.path, acme.licence) == (package / "net-acme.safetensors", "acme: MIT")
    with pytest.raises(UnknownNameError, match=r"net: unknown weights 'acne'; expected one of: acme, free.*mean acme"):
        weights_of("net", "acne", shipped)
    with pytest.raises(UnknownNameError, match="unknown weights 'acme'"):
        weights_of("another", "acme")
    path = tmp_path / "own.safetensors"
    path.touch()
    weights = weights_of("net", str(path))
    assert (weights.path, weights.licence) == (path, "own.safetensors: the terms of its training data apply")
