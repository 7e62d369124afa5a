"""Comparison without ground truth: figures in closed form, and runs on tiny frames by methods of known spread."""

from __future__ import annotations

import json
import os
import signal
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from p2o import InputError, Recipe, Registry, UnknownNameError, se3
from p2o.cache import FeatureCache
from p2o.cli import INTERRUPTED, main
from p2o.run.presets import Preset, preset_of
from p2o_study import compare as module
from p2o_study import comparison as figures
from p2o_study.compare import Comparison, compare, contenders_of, family_of, split_frames
from p2o_study.comparison import Samples, Standing
from p2o_study.report.comparison_page import comparison_page, comparison_text
from p2o_study.rows import Rows
from p2o_study.statistics import Interval
from p2o_study.worker import Plugins

from tests.page_description import column, description, table
from tests.study_bench import PLUGIN, Bench
from tests.study_plugin import TRUTH

OWN = PLUGIN.with_name("compare_plugin.py")
PLUGINS = Plugins(files=(str(PLUGIN), str(OWN)))
EDGES = Preset("edges", {"extractor": "tiny/tiny", "matcher": "ogm", "init": "given"}, {})
GUESS = np.array([1.0, 0, 0, 0, 0.1, 0])
rng = np.random.default_rng(3)


def samples_of(tangents: dict[str, np.ndarray], families: dict[str, str] | None = None, **words: Any) -> Samples:
    """Return samples of tangents (G, S, 6) by method; each method is its own family unless `families` names others."""
    stack = np.array([*tangents.values()])
    guesses = np.broadcast_to(np.random.default_rng(5).normal(size=stack.shape[1:]), stack.shape)
    own = [(families or {}).get(name, name) for name in tangents]
    return Samples([*tangents], own, stack, words.get("guesses", guesses), {}, {})


def noise(size: float, groups: int = 8, seeds: int = 2) -> np.ndarray:
    return size * rng.normal(size=(groups, seeds, 6))


def test_tangents_are_rotation_vectors_and_translations() -> None:
    reference = se3.exp(rng.normal(size=6))
    poses = np.array([se3.exp(0.3 * rng.normal(size=6)) @ reference for _ in range(5)])
    tangents = figures.to_tangents(poses, reference)
    step = se3.inverse(reference) @ poses[0]
    np.testing.assert_allclose(np.linalg.norm(tangents[0, :3]), se3.angle_deg(step))
    np.testing.assert_allclose(np.linalg.norm(tangents[0, 3:]), se3.distance_m(step))
    np.testing.assert_allclose(figures.reference_pose(np.repeat(poses[:1], 3, axis=0)), poses[0], atol=1e-12)


def test_repeatability_is_the_spread_within_and_between_groups() -> None:
    groups = np.array([1.0, -1.0] * 4)[:, None, None]
    guesses = np.array([0.5, -0.5])[None, :, None]
    tangents = 0.3 * groups * np.eye(6)[0] + 2.0 + 0.2 * guesses * np.eye(6)[4]
    values, _ = figures.figures_of(samples_of({"a": tangents, "b": 2 * tangents}))
    between, within = 0.3 * np.sqrt(8 / 7), 0.1 * np.sqrt(2)
    np.testing.assert_allclose(values["groups_deg"][0], [between, 2 * between])
    np.testing.assert_allclose(values["guesses_deg"][0], 0, atol=1e-9)
    np.testing.assert_allclose(values["guesses_m"][0], [within, 2 * within])
    np.testing.assert_allclose(values["groups_m"][0], 0, atol=1e-7)
    np.testing.assert_allclose(values["repeatability_deg"][0], values["groups_deg"][0])
    np.testing.assert_allclose(values["repeatability_m"][0], values["guesses_m"][0] / np.sqrt(2), atol=1e-7)
    assert values["groups_deg"].shape == (2001, 2)
    assert np.sqrt(np.mean(values["groups_deg"][1:, 0] ** 2)) == pytest.approx(between, rel=0.05), "unbiased"


def test_the_consensus_is_the_median_of_the_other_families() -> None:
    places = {"a": 0.0, "b": 0.1, "c": 0.2, "d": 9.0}
    means = np.array([[[place, 0, 0, place, 0, 0] for place in places.values()]])
    result = figures.consensus(means, np.ones((1, 4)), [*places])
    np.testing.assert_allclose(result[0, :, 0], [0.2, 0.2, 0.1, 0.1], atol=1e-6)
    together = figures.consensus(means, np.ones((1, 4)), ["x", "x", "y", "z"])
    np.testing.assert_allclose(together[0, :, 3], [4.6, 4.6, 4.525, 0.125], atol=1e-6)  # x is at 0.05


def test_the_median_follows_the_weights() -> None:
    points = np.array([[[0.0, 0], [1, 0], [5, 0]]] * 2)
    weights = np.array([[1.0, 1, 1], [1, 1, 5]])
    np.testing.assert_allclose(figures.geometric_median(points, weights), [[1, 0], [5, 0]], atol=1e-6)
    square = np.array([[[0.0, 0], [0, 1], [1, 0], [1, 1]]])
    np.testing.assert_allclose(figures.geometric_median(square, np.ones((1, 4))), [[0.5, 0.5]], atol=1e-6)


def test_methods_of_one_spread_form_the_top_group_and_a_scattered_one_does_not() -> None:
    ranking = figures.standings(samples_of({"wild": noise(3.0), "fine": noise(0.1), "good": noise(0.1)}))
    assert {s.name: s.tier for s in ranking} == {"fine": 1, "good": 1, "wild": 2}
    assert ranking[-1].name == "wild"
    interval = ranking[0].figures["repeatability_deg"]
    assert interval.low < interval.value < interval.high
    equal = noise(1.0)
    assert [s.tier for s in figures.standings(samples_of({"a": equal, "b": equal, "c": equal}))] == [1, 1, 1]


def test_neither_score_nor_scatter_may_distinguish_the_methods_of_a_tier() -> None:
    equal, worse = np.zeros((201, 1)), np.ones((201, 1))
    sometimes = np.where(np.arange(201) % 20 == 1, 0.0, worse[:, 0])[:, None]  # as good in 5 % of the samples
    scores = np.concatenate([equal, equal, worse, sometimes], axis=1)
    scatter = np.concatenate([equal, worse, equal, equal], axis=1)
    assert figures.tiers_of(scores, scatter).tolist() == [1, 2, 3, 1]
    assert figures.tiers_of(scores[:, 2:], scatter[:, 2:]).tolist() == [1, 1]


def test_a_method_that_returns_its_guess_is_named_and_one_that_ignores_it_is_not() -> None:
    guesses = np.broadcast_to(noise(1.0, 20, 3), (2, 20, 3, 6))
    still = samples_of({"stuck": guesses[0], "free": noise(0.1, 20, 3)}, guesses=guesses)
    ranking = figures.standings(still)
    follows = {s.name: s.follows for s in ranking}
    assert follows["stuck"] == pytest.approx(1)
    assert abs(follows["free"]) < 0.1
    assert "stuck keeps 100 % of the error of its initial guess" in figures.remarks(ranking, {})


def test_poses_are_judged_on_other_groups_only_and_by_judges_without_their_features() -> None:
    costs = np.zeros((3, 6, 2, 6))
    for method, cost in enumerate((3.0, 2.0, 1.0)):
        costs[method] = cost
        costs[method, np.arange(6), :, np.arange(6)] = 1e6  # on the own group
    costs[..., 4] = np.nan
    one = samples_of({"a": noise(1.0, 6), "b": noise(1.0, 6), "c": noise(1.0, 6)})
    shares = {"x": np.array([False, False, True]), "y": np.array([True, False, False])}
    its = Samples(one.names, one.families, one.tangents, one.guesses, {"x": costs, "y": -costs}, shares)
    values, _ = figures.figures_of(its)
    np.testing.assert_allclose(values["x"], np.broadcast_to([3.0, 2, 1], values["x"].shape))
    ranks = figures._judged_ranks({"x": values["x"], "y": values["y"]}, shares)
    # x ranks b before a, y ranks b before c: c is not ranked by x, nor a by y.
    np.testing.assert_allclose(ranks[0], [1, 0, 1])
    alone = figures._judged_ranks({"x": values["x"]}, {"x": np.ones(3, bool)})
    np.testing.assert_allclose(alone[0], [1, 0.5, 0], err_msg="without another judge, the own one ranks")


def test_the_sentence_names_the_top_group_and_how_much_others_scatter() -> None:
    def standing(name: str, tier: int, deg: float) -> Standing:
        return Standing(name, name, tier, 0.0, 0.0, {f"repeatability_{u}": Interval(deg) for u in ("deg", "m")})

    ranking = [standing("ours", 1, 0.1), standing("nid", 1, 0.1), standing("gmm", 2, 0.3)]
    apart = [("ours", "nid", 0.2, 0.03), ("ours", "gmm", 1.0, 0.1), ("nid", "gmm", 1.0, 0.1)]
    assert figures.sentence(ranking, apart, 24) == (
        "On these 24 frames ours and nid agree within 0.2 deg / 3 cm and are indistinguishable at 95 %; gmm scatters 3 "
        "times more."
    )
    assert "ours ranks first, distinguishable" in figures.sentence([ranking[0], ranking[2]], apart, 24)
    assert "ours and nid differ by up to 3 deg" in figures.sentence(ranking, [("ours", "nid", 3.0, 0.03)], 24)


def test_names_are_presets_with_the_options_of_their_study_and_families() -> None:
    registry = Plugins().registry()
    names = ["ours", "ours-without-prior", "nid", "canny", "hand-eye", "koo", "lccnet", "mask-consistency"]
    contenders = contenders_of(names, registry)
    assert contenders[2].words["extractor"] == "grey/reflectance"
    assert contenders[2].options["pipeline"]["rounds"] == 1
    assert contenders[1].options == {"init": {"prior": 0.0}}
    file = module.compare_study(contenders, "synthetic:?scenes=5", [[0, 5], [1]], 2)
    assert file.dataset[0].frames == "0:1,5:6"
    families = {row.section: family_of(row.resolve(registry, 0)) for row in file.rows()}
    assert [*families.values()] == [*["edges"] * 2, "information", "edges", "motion", "targets", "network", "segments"]
    with pytest.raises(UnknownNameError, match="did you mean hand-eye"):
        contenders_of(["ours", "hand-eyes"], registry)
    with pytest.raises(InputError, match="named twice"):
        contenders_of(["ours", "ours"], registry)


def test_judges_need_no_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cma", None)
    registry = Registry.load(plugins=["p2o-calib"])
    for name in module.JUDGES.values():
        method = module._evaluating(preset_of(name, registry))
        assert Recipe.of(**method.merged({"data": "synthetic:"})).resolve(registry).calibrator()


def test_groups_are_interleaved_and_too_few_frames_are_refused() -> None:
    registry = PLUGINS.registry()
    assert split_frames("tiny:?frames=12", "all", 5, registry) == [[0, 5, 10], [1, 6, 11], [2, 7], [3, 8], [4, 9]]
    assert split_frames("tiny:?frames=12", "11,3,2,1,0", 5, registry) == [[0], [1], [2], [3], [11]]
    with pytest.raises(InputError, match="--frames: too few frames"):
        split_frames("tiny:?frames=4", "all", 5, registry)
    with pytest.raises(InputError, match="--groups: too few groups"):
        split_frames("tiny:?frames=12", "all", 4, registry)


def run(bench: Bench, names: str, data: str = "tiny:?frames=12", out: str = "out", **words: Any) -> Any:
    contenders = contenders_of(names.split(","), PLUGINS.registry())
    words = {"groups": 6, "judges": {}, "plugins": PLUGINS, "cache": FeatureCache(bench.root / "cache"), **words}
    return compare(contenders, data, bench.root / out, **words)


def test_methods_of_known_spread_are_ranked_without_their_truth(bench: Bench) -> None:
    done, comparison = run(bench, "stuck,loose,sharp")
    assert (done.computed, comparison.frames, comparison.groups) == (3 * 6 * 3, 12, 6)
    assert comparison.ranking[0].name == "sharp"
    assert comparison.ranking[0].tier == 1
    by_name = {s.name: s for s in comparison.ranking}
    assert by_name["sharp"].scatter_m < 0.3 * by_name["loose"].scatter_m
    assert by_name["sharp"].figures["guesses_deg"].value == pytest.approx(0, abs=1e-6)
    assert by_name["stuck"].follows == pytest.approx(1, abs=0.02)
    starts = {(row.dataset, row.seed): row.case.start.tobytes() for row in done.rows if row.section == "sharp"}
    assert len(set(starts.values())) == 18, "each group begins elsewhere"
    assert all(row.case.start.tobytes() == starts[row.dataset, row.seed] for row in done.rows), (
        "the same for all methods"
    )
    _, blind = run(bench, "stuck,loose,sharp", "blind:?frames=12", "blind")
    assert blind.sentence == comparison.sentence
    assert not len(blind.outcomes["sharp"].errors("rotation_deg"))
    assert comparison.outcomes["sharp"].average("rotation_deg") < 0.2
    for own, other in zip(comparison.ranking, blind.ranking, strict=True):
        for name, value in own.figures.items():
            assert other.figures[name].value == pytest.approx(value.value, abs=1e-9)


def test_edges_judge_poses_on_frames_that_had_no_part_in_them(bench: Bench) -> None:
    _, comparison = run(bench, "stuck,sharp", judges={"edges": EDGES}, seeds=2)
    by_name = {s.name: s.figures["edges"].value for s in comparison.ranking}
    assert by_name["sharp"] < by_name["stuck"] - 1
    assert comparison.shares == {"edges": {"stuck": False, "sharp": False}}
    stereo = Preset("stereo", {**EDGES.words, "extractor": "stereo/tiny"}, {})
    partly = Preset("partly", EDGES.words, {"extractor": {"fail_on": 0}})
    _, own = run(bench, "stuck,sharp", judges={"stereo": stereo, "partly": partly}, seeds=2)
    assert [*own.shares] == ["partly"], "the groups that it can judge"
    assert any(line.startswith("no held-out agreement by stereo: ") for line in own.remarks)


def test_a_restarted_comparison_computes_what_is_missing(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    tired = [Preset("quick", {"calibrator": "quick"}, {"calibrator": {"interrupt_after": 5}})]
    words: dict[str, Any] = {"groups": 5, "judges": {}, "plugins": PLUGINS, "cache": FeatureCache(bench.root / "c")}
    done, comparison = compare(tired, "tiny:?frames=5", bench.root / "o", **words)
    assert (done.interrupted, comparison, len(done.rows)) == (True, None, 4)
    done, comparison = compare(tired, "tiny:?frames=5", bench.root / "o", **words)
    assert (done.computed, len(done.rows)) == (11, 15)
    assert isinstance(comparison, Comparison)
    assert "a ranking needs two methods" in comparison.sentence
    again, same = compare(tired, "tiny:?frames=5", bench.root / "o", **words)
    assert again.computed == 0
    assert same.as_dict() == comparison.as_dict()


def test_an_interrupted_comparison_ranks_what_is_finished(bench: Bench) -> None:
    finished = contenders_of(["sharp", "loose"], PLUGINS.registry())
    tired = Preset("tired", {"calibrator": "quick"}, {"calibrator": {"interrupt_after": 3}})
    words: dict[str, Any] = {"groups": 5, "judges": {"edges": EDGES}, "plugins": PLUGINS}
    words |= {"cache": FeatureCache(bench.root / "c"), "seeds": 2}
    done, comparison = compare([*finished, tired], "tiny:?frames=10", bench.root / "o", **words)
    assert (done.interrupted, len(done.rows)) == (True, 12), "one seed of all methods before the next"
    assert isinstance(comparison, Comparison)
    assert comparison.interrupted
    assert [standing.name for standing in comparison.ranking] == ["sharp", "loose"]
    assert comparison.remarks[0].startswith(
        "interrupted: 12 of 30 calibrations are finished; 2 methods, 5 groups and 1 "
    )
    done, comparison = compare([*finished, tired], "tiny:?frames=10", bench.root / "o", **words)
    assert done.computed == 30 - 12
    assert isinstance(comparison, Comparison)
    assert (comparison.interrupted, len(comparison.ranking), [*comparison.shares]) == (False, 3, ["edges"])


@pytest.mark.parametrize(
    ("finished", "methods", "count"),
    [
        ({"a": 10, "b": 10, "c": 4}, {"a", "b"}, 20),
        ({"a": 10, "b": 7}, {"a", "b"}, 10),
        ({"a": 5, "b": 5, "c": 5}, {"a", "b", "c"}, 15),
        ({"a": 4, "b": 3}, set(), 0),
    ],
)
def test_the_finished_rows_that_are_ranked_have_the_same_groups_and_seeds(
    finished: dict[str, int], methods: set[str], count: int
) -> None:
    rows: Any = [
        SimpleNamespace(section=name, dataset=f"g{i % 5}", seed=i // 5)
        for name, n in finished.items()
        for i in range(n)
    ]
    chosen = module._complete(rows)
    assert ({row.section for row in chosen}, len(chosen)) == (methods, count)


def test_guesses_that_do_not_differ_and_several_rigs_are_refused(bench: Bench) -> None:
    with pytest.raises(InputError, match="would repeat perfectly"):
        run(bench, "sharp", perturb="1deg")
    guesses = module.Guesses.of(None, "1deg 0.1m", PLUGINS.registry())
    record: Any = type("Record", (), {"start": np.eye(4), "source": type("Source", (), {"index": 0}), "name": "a"})
    first = guesses("group-00000", [record], None, 0)
    assert se3.angle_deg(first) == pytest.approx(1)
    record.start = se3.make(None, [0, 0, 1.0])
    with pytest.raises(InputError, match="frames have different extrinsics"):
        guesses("group-00001", [record], None, 0)
    file = bench.root / "extrinsic.yaml"
    file.write_text(f"camera_from_lidar: {TRUTH.ravel().tolist()}\n")
    around = module.Guesses.of(str(file), "1deg 0.1m", PLUGINS.registry())("group-00001", [record], np.eye(4), 0)
    assert se3.distance_m(se3.inverse(TRUTH) @ around) == pytest.approx(0.1), "a file has priority over the data"


def test_a_method_without_an_estimate_is_not_ranked(bench: Bench) -> None:
    _, comparison = run(bench, "refusing,sharp,loose", seeds=1)
    assert comparison.unranked == ["refusing"]
    assert "refusing gives no estimate: it stays" in comparison.remarks
    with pytest.raises(InputError, match="no method gives an estimate"):
        run(bench, "refusing", seeds=1)


def test_frames_that_cannot_be_read_cost_their_group(bench: Bench) -> None:
    _, comparison = run(bench, "sharp,loose", "tiny:?frames=12&bad=3", seeds=1)
    assert comparison.groups == 5
    with pytest.raises(InputError, match="too few groups of frames can be read"):
        run(bench, "sharp,loose", "tiny:?frames=10&bad=3", groups=5, seeds=1)


def test_the_command_prints_the_ranking_and_writes_page_and_json(
    bench: Bench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "JUDGES", {})
    monkeypatch.setenv("P2O_CACHE", str(bench.root / "cache"))
    out = bench.root / "out"
    words = ["compare", "tiny:?frames=10", "--groups", "5", "--seeds", "2", "--out", str(out), "--quiet"]
    words += ["--plugin", str(PLUGIN), "--plugin", str(OWN)]
    assert main([*words, "--methods", "sharp,loose"]) == 0
    text = capsys.readouterr().out
    assert "\nOn these 10 frames sharp ranks first" in text
    assert "truth" in text
    ranking = table(description(out / "compare.html"), "ranking")
    assert (column(ranking, "method"), column(ranking, "group")) == (["sharp", "loose"], [1, 2])
    assert ranking["rows"][0][3].keys() == {"v", "lo", "hi"}
    content = json.loads((out / "compare.json").read_text())
    assert [method["tier"] for method in content["ranking"]] == [1, 2]
    assert main([*words, "--methods", "sharp,loose", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == content
    assert main([*words, "--methods", "sharp,refusing"]) == 1
    capsys.readouterr()
    assert main([*words, "--methods", "sharp,lose"]) == 2
    assert "did you mean loose" in capsys.readouterr().err
    assert main(["compare", "--methods", "sharp"]) == 2
    assert "Missing argument '[DATASET:]PATH'" in capsys.readouterr().err


def test_a_plugin_of_another_package_runs_in_a_worker_which_it_may_crash(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "JUDGES", {})
    monkeypatch.setenv("P2O_CACHE", str(bench.root / "cache"))
    out = str(bench.root / "out")
    words = ["compare", "--groups", "5", "--methods", "elsewhere", "tiny:?frames=5", "--out", out, "--quiet"]
    assert main([*words, "--plugin", str(PLUGIN), "--plugin", str(OWN)]) == 0
    reasons = {row.reason for row in Rows(out).each("compare")}
    assert reasons
    assert f"process {os.getpid()}" not in reasons


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_command_with_the_ranking_of_what_is_finished(
    bench: Bench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    put, rows = Rows.put, []

    def interrupted(stored: Rows, study: str, row: Any) -> None:
        put(stored, study, row)
        rows.append(row)
        if len(rows) == 12:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(Rows, "put", interrupted)
    monkeypatch.setenv("P2O_CACHE", str(bench.root / "cache"))
    words = ["compare", "tiny:?frames=10", "--groups", "5", "--seeds", "2", "--out", str(bench.root / "out"), "--json"]
    words += ["--plugin", str(PLUGIN), "--plugin", str(OWN), "--methods", "sharp,loose,stuck"]
    assert main(words) == INTERRUPTED
    captured = capsys.readouterr()
    ranking = json.loads(captured.out)
    assert ranking["interrupted"]
    assert [method["name"] for method in ranking["ranking"]] == ["sharp", "loose"]
    assert captured.err.splitlines() == [
        f"p2o: interrupted; 12 rows are kept in {bench.root / 'out'}; the same command continues"
    ]


def test_names_in_the_page_are_text(bench: Bench) -> None:
    _, comparison = run(bench, "sharp,loose", seeds=1)
    odd = {"<b>": comparison.outcomes["sharp"]}
    first = Standing("<b>", "<i>", 1, 0.0, 0.0, comparison.ranking[0].figures)
    its = Comparison("<script>", ["\x1b[31m"], 1, 1, "1deg", [first], [], odd, {}, [])
    page = comparison_page(its)
    assert "<b>" not in page
    assert page.count("<script>") == 1, "that of the page itself"
    assert "\x1b" not in page + comparison_text(its)
