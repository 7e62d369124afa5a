"""Methods by one name: what they stand for, and that other words override them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from p2o import Kind, Recipe, Registry, UnknownNameError
from p2o.cli import main
from p2o.run.presets import preset_of, presets
from p2o_study.study import find_study

REGISTRY = Registry.load()


@pytest.mark.parametrize("name", list(presets(REGISTRY)))
def test_every_published_method_fits_together(name: str) -> None:
    plan = Recipe.of(**preset_of(name, REGISTRY).merged({"data": "synthetic:"})).resolve(REGISTRY)
    assert plan.parts["matcher"].offer.name == presets(REGISTRY)[name].words["matcher"]


def test_every_matcher_and_calibrator_is_a_method_and_an_unknown_one_is_refused() -> None:
    for kind in (Kind.MATCHER, Kind.CALIBRATOR):
        for offer in REGISTRY.of_kind(kind):
            words = preset_of(offer.name, REGISTRY).merged({"data": None})
            Recipe.of(**words).resolve(REGISTRY)
    with pytest.raises(UnknownNameError, match=r"--method: unknown method 'hand-ey'.*did you mean hand-eye"):
        preset_of("hand-ey", REGISTRY)


def test_published_methods_are_those_of_the_study_of_rivals() -> None:
    def plan(words: dict[str, object]) -> dict[str, object]:
        return Recipe.of(**{"data": None, **words}).resolve(REGISTRY).described()

    rows = [row for row in find_study("rivals", REGISTRY).rows() if not row.joint]
    alone = ("perturb", "witness")
    of_study = [plan({k: v for k, v in row.words.items() if k not in alone}) for row in rows]
    own = ("ours-without-prior", "paper")
    of_names = [plan(preset.merged({})) for name, preset in presets(REGISTRY).items() if name not in own]
    key = lambda words: json.dumps(words, sort_keys=True)  # noqa: E731
    assert sorted(map(key, of_study)) == sorted(map(key, of_names))


def test_other_words_and_options_override_those_of_the_method() -> None:
    words = preset_of("nid", REGISTRY).merged(
        {"solver": "nelder-mead", "options": {"pipeline": {"reach_px": 9.0}, "matcher": {"bins": 20}}}
    )
    assert (words["matcher"], words["solver"]) == ("nid", "nelder-mead")
    assert words["options"]["pipeline"] == {"reach_px": 9.0, "rounds": 1}
    assert words["options"]["matcher"] == {"bins": 20}
    assert presets(REGISTRY)["nid"].options["pipeline"] == {"rounds": 1}


@pytest.mark.parametrize(
    ("word", "name", "stage"),
    [("solver", "bfgs", "solver"), ("extractor", "grey/rings", "cloud"), ("extractor", "hed/reflectance", None)],
)
def test_options_of_a_replaced_method_are_left_out(word: str, name: str, stage: str | None) -> None:
    options = preset_of("nid", REGISTRY).options
    merged = preset_of("nid", REGISTRY).merged({word: name})
    assert merged[word] == name
    assert merged["options"] == {at: values for at, values in options.items() if at != stage}


def test_what_a_method_stands_for_is_a_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    small = ["synthetic:?scenes=1&width_px=310&height_px=94&right=false", "--perturb", "1deg 0.05m", "--json"]
    recipes = []
    for words in (["--method", "gmm"], str(preset_of("gmm", REGISTRY)).split()):
        assert main(["run", *small, *words]) in (0, 1)
        recipes.append(json.loads(capsys.readouterr().out)["results"][0])
    first, second = ({k: v for k, v in result.items() if k != "seconds"} for result in recipes)
    assert first == second
    assert first["recipe"]["matcher"] == "gmm"
