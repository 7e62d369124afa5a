"""The public names are guarded: nothing is lost or renamed by accident."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import p2o
from p2o import Kind
from p2o.host import hookspecs
from p2o.run.recipe import STAGES

KNOWN = Path(__file__).with_name("public_names.json")


def current() -> dict[str, list[str]]:
    """Return every name that users and plugin authors rely on; `python -m tests.test_public_names` writes them."""
    testing = importlib.import_module("p2o.testing")
    return {
        "names": sorted(p2o.__all__),
        "hooks": sorted(name for name in vars(hookspecs) if name.startswith("p2o_")),
        "stages": sorted(STAGES),
        "recipe": sorted(p2o.Recipe.model_fields),
        "method": sorted(p2o.Method.__dataclass_fields__),
        "example": sorted(p2o.Example.__dataclass_fields__),
        "testing": sorted(testing.__all__),
        "checks": sorted(check.name for check in testing.CHECKS),
        "statuses": sorted(status.value for status in p2o.Status),
    }


def test_no_public_name_is_lost_and_new_ones_are_written_down() -> None:
    known = json.loads(KNOWN.read_text())
    for group, names in current().items():
        lost = set(known[group]) - set(names)
        assert not lost, f"{group} lost {sorted(lost)}: keep the name, or raise the major version"
        assert not set(names) - set(known[group]), f"new {group}: run `python -m tests.test_public_names`"


def test_python_and_type_checkers_find_every_public_name_in_the_same_module() -> None:
    text = Path(p2o.__file__).read_text(encoding="utf-8")
    declared = re.findall(r"^    from (p2o[\w.]*) import (\w+) as (\w+)$", text, re.MULTILINE)
    assert sorted(name for _, _, name in declared) == sorted(p2o.__all__) == sorted(dir(p2o))
    for module, there, name in declared:
        assert there == name
        assert getattr(p2o, name) is getattr(importlib.import_module(module), there)


def test_there_is_a_hook_for_every_kind() -> None:
    assert sorted(kind.hook for kind in Kind) == current()["hooks"]


if __name__ == "__main__":
    KNOWN.write_text(json.dumps(current(), indent=1) + "\n")
