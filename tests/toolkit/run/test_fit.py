"""A stage needs content that a previous stage gives; content that is missing is named with both methods."""

from __future__ import annotations

from typing import Any

import pytest
from p2o import Kind, Method
from p2o.host.registry import Offer
from p2o.run.fit import misfit_of

STAGES = {
    "data": Kind.DATASET,
    "accumulate": Kind.ACCUMULATOR,
    "extractor": Kind.IMAGE_EXTRACTOR,
    "cloud": Kind.CLOUD_EXTRACTOR,
    "matcher": Kind.MATCHER,
    "solver": Kind.SOLVER,
    "calibrator": Kind.CALIBRATOR,
}


def offer(stage: str, needs: str = "", gives: str = "") -> Offer:
    """Return a method of a stage that needs and gives these words, named after the stage."""
    words: dict[str, Any] = {"needs": set(needs.split()), "gives": set(gives.split())}
    method = Method(name=stage, build=lambda _: None, summary="A test.", **words)
    return Offer(STAGES[stage], method, "acme", "1", "")


def misfit(contents: frozenset[str] | None = None, **stages: tuple[str, str]) -> tuple[str, str, str] | None:
    """Return the missing word, who should give it and who needs it; stages are (needs, gives)."""
    found = misfit_of({name: offer(name, *words) for name, words in stages.items()}, contents)
    return found and (found[0], found[1].name, found[2].name)


EDGES = {"extractor": ("", "image-edges side"), "cloud": ("", "cloud-edges side")}


@pytest.mark.parametrize(
    ("needs", "missing"),
    [
        ("image-edges cloud-edges side", None),
        ("image-grey", ("image-grey", "extractor", "matcher")),
        ("cloud-planes", ("cloud-planes", "cloud", "matcher")),
        ("labels", ("labels", "extractor", "matcher")),
    ],
)
def test_a_matcher_needs_what_both_extractors_give(needs: str, missing: tuple[str, str, str] | None) -> None:
    assert misfit(**EDGES, matcher=(needs, "pairs")) == missing
    blunt = {**EDGES, "cloud": ("", "cloud-edges")}  # what has no prefix must come from both
    assert misfit(**blunt, matcher=("side", "pairs")) == ("side", "cloud", "matcher")


@pytest.mark.parametrize("needs", ["pairs", "residuals", "objective"])
@pytest.mark.parametrize("gives", ["pairs", "residuals", "objective"])
def test_pairs_imply_residuals_and_residuals_imply_an_objective(needs: str, gives: str) -> None:
    order = ["pairs", "residuals", "objective"]
    fits = order.index(gives) <= order.index(needs)
    assert misfit(matcher=("", gives), solver=(needs, "")) == (None if fits else (needs, "matcher", "solver"))


def test_optional_content_of_frames_is_open_until_they_are_read() -> None:
    stages = {"data": ("", "intensity"), "cloud": ("rings", "cloud-edges")}
    assert misfit(**stages) is None
    assert misfit(frozenset({"rings"}), **stages) is None
    assert misfit(frozenset({"time"}), **stages) == ("rings", "data", "cloud")
    # A data set that declares its content has no other but that of frames.
    assert misfit(data=("", "intensity"), calibrator=("radar", "")) == ("radar", "data", "calibrator")
    assert misfit(data=("", ""), calibrator=("radar", "")) is None


@pytest.mark.parametrize("word", ["rings", "time", "twist"])
def test_accumulated_sweeps_have_neither_rings_nor_times(word: str) -> None:
    sweeps = {"data": ("", "rings time twist"), "cloud": (word, "cloud-edges")}
    assert misfit(**sweeps) is None
    assert misfit(**sweeps, accumulate=("", "dense")) == (word, "data", "cloud")
