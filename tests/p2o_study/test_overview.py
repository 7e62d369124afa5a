"""What published methods need, are for, measured and published is rendered from rows, and shipped."""

from __future__ import annotations

from pathlib import Path

import p2o
import pytest
from p2o.cli import main
from p2o.errors import UnknownNameError
from p2o.run.overview import method_facts
from p2o.run.presets import preset_of
from p2o_study.benchmark import overview
from p2o_study.benchmark.suite import find_suite
from p2o_study.benchmark.tables import SuiteTables
from p2o_study.rows import Rows

ROOT = Path(__file__).parents[2]


def test_the_matrix_states_needs_use_and_errors_of_methods(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["methods", "--matrix"]) == 0
    text = capsys.readouterr().out
    block = text.partition("\nidt (")[2].partition("\nline-idt (")[0]
    assert [line.split()[0] for line in block.splitlines()[1:]] == ["needs", "for", "measured", "published"]
    assert "rings" in block.splitlines()[1]
    assert main(["methods", "idt"]) == 0
    assert block.splitlines()[3] in capsys.readouterr().out


def test_every_method_with_facts_is_installed_and_has_needs_that_frames_can_have() -> None:
    registry = p2o.Registry.load(environ={})
    facts = method_facts(registry)
    assert len({one.name for one in facts}) == len(facts) > 30
    for one in facts:
        assert preset_of(one.name, registry).words
        assert one.paper
        assert one.use


def test_a_row_that_its_suite_lacks_is_named() -> None:
    registry = p2o.Registry.load(environ={})
    rows = Rows(ROOT / "benchmarks/results")

    def tables(suite: str) -> SuiteTables:
        known = SuiteTables.read(find_suite(suite, registry), rows)
        return SuiteTables(known.suite, known.lines, [key for key in known.asked if key.label != "levinson"])

    with pytest.raises(UnknownNameError, match=r"overview.toml, idt: unknown row .*levinson"):
        overview.overviews(registry, tables)
