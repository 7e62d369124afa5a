"""The changelog and the citation file describe the version of the package."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    """The table `project` of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def citation() -> dict[str, Any]:
    """The content of CITATION.cff."""
    return yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


def test_the_first_section_of_the_changelog_is_that_of_the_version(project: dict[str, Any]) -> None:
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert next(heading for heading in headings if heading != "Unreleased").split()[0] == project["version"]


def test_the_citation_is_that_of_the_version(citation: dict[str, Any], project: dict[str, Any]) -> None:
    assert (citation["title"], citation["version"]) == (project["name"], project["version"])


def test_the_citation_has_what_version_1_2_0_of_its_format_requires(citation: dict[str, Any]) -> None:
    assert citation["cff-version"] == "1.2.0"
    assert citation["message"]
    for work in (citation, citation["preferred-citation"]):
        assert work["title"]
        assert work["authors"]
        assert all("name" in author or "family-names" in author for author in work["authors"])
