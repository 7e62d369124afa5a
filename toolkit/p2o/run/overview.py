"""What published methods need, are for, and reach: facts that plugin packages ship, rendered from rows of suites."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from p2o.files.parsed_text import parse_json
from p2o.host.registry import Registry
from p2o.host.shipped import shipped_files
from p2o.results.json_types import Schema

FILE = "overview.json"
"""The file of a package with the facts of its methods, in the order in which they are listed."""


@dataclass(frozen=True)
class MethodFacts:
    """One method: its paper, the optional content of frames that it `needs`, its use, and errors as texts."""

    name: str
    paper: str
    needs: tuple[str, ...]
    use: str
    measured: str
    published: str

    @property
    def needs_text(self) -> str:
        """What it needs as text."""
        return ", ".join(self.needs) or "an image, a sweep"

    def as_dict(self) -> dict[str, Any]:
        """Return the facts for JSON."""
        return asdict(self)


def method_facts(registry: Registry) -> list[MethodFacts]:
    """Return the facts of the methods of loaded plugins; raises InputError for a file that is not valid."""
    schema = Schema(list[MethodFacts])
    return [
        facts
        for _, file in shipped_files(registry)
        if file.name == FILE
        for facts in schema.read(parse_json(file.read_bytes(), "overview of methods", str(file)))
    ]
