"""Families of staged methods beside our own, as plugins that bring features and problems of kinds that p2o lacks.

Each runs from the shell and in studies, keeps the contracts of its slots, and comes near the truth on a simulated case
that was made for it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import p2o
import pytest
from p2o import Kind
from p2o.cache import FeatureCache
from p2o.cli import main
from p2o.host import guard
from p2o.host.registry import Offer
from p2o_study import worker
from p2o_study.ablate import Ablation, ablate
from p2o_study.parallel import Workers
from p2o_study.study import StudyFile, parse_study
from p2o_study.worker import Plugins
from p2o_testing import Case, checks_for

from tests.test_architecture import Source, private_names

FOLDER = Path(__file__).with_name("family_plugins")
SMALL = "synthetic:?seed=0&place=yard&width_px=621&height_px=188&right=false&exposure_ev=0"


@dataclass(frozen=True)
class Family:
    """A plugin, the words that run it, and how near to the truth (degrees, metres) it comes from 1 deg and 5 cm."""

    file: str
    data: str
    words: dict[str, str]
    options: dict[str, Any]
    within: tuple[float, float]
    frames: str = "all"

    @property
    def path(self) -> Path:
        return FOLDER / self.file

    def checks(self) -> list[Case]:
        """Return the conformance checks of all its methods."""
        registry = Plugins(files=(str(self.path),)).registry()
        own = [offer for offer in registry.offers if offer.dist == self.file]
        return [case for offer in own for case in checks_for(offer, registry=registry)]

    def shell(self) -> list[str]:
        """Return the words of `p2o run`, all frames together."""
        words = [part for word, value in self.words.items() for part in (f"--{word}", value)]
        settings = [part for name, value in self.options.items() for part in ("--set", f"{name}={value}")]
        asked = ["--data", self.data, "--frames", self.frames, "--joint", "--perturb", "1deg 0.05m"]
        return ["run", "--plugin", str(self.path), *asked, *words, *settings, "--json"]

    def study(self, more: str = "") -> str:
        """Return a study of two seeds, all frames together."""
        words = "\n".join(f'{word} = "{value}"' for word, value in self.words.items())
        options = "\n".join(f"options.{name} = {value}" for name, value in self.options.items())
        return f"""name = "family"
title = "Family"
perturb = "1deg 0.05m"
seeds = 2
joint = true
[[dataset]]
name = "made"
data = "{self.data}"
frames = "{self.frames}"
[defaults]
{words}
{options}
[[row]]
label = "all"
{more}"""


# Reflectance and grey go together on a checkerboard: dark squares send a tenth back to both sensors.
INFORMATION = Family(
    "mutual_information.py",
    f"{SMALL}&scenes=2&targets=checkerboard&boards=2&lidar=os1-64",
    {
        "extractor": "blurred-grey/plain-reflectance",
        "matcher": "mutual-information",
        "solver": "nelder-mead",
        "init": "given",
        "witness": "none",
    },
    {
        "solver.restarts": 0,
        "solver.tolerance": 1e-2,
        "pipeline.shrink": 0.4,
        "pipeline.rounds": 4,
        "cloud.points": 6000,
    },
    within=(0.2, 0.03),
)
# Boards have straight outlines that both sensors see; turned to all sides they tell all six unknowns.
LINES = Family(
    "line_segments.py",
    f"{SMALL}&scenes=3&targets=holes&boards=2&holder=stand&lidar=os1-128&noise_m=0.01",
    {"extractor": "segments/jumps", "matcher": "segments", "solver": "lm", "init": "given", "witness": "none"},
    {"pipeline.reach_px": 20},
    within=(0.2, 0.03),
)
# A yard has no traffic. Five sweeps of 32 beams fill the gaps between them, as the car sways on its springs.
DENSE = Family(
    "accumulated.py",
    f"{SMALL}&scenes=3&frames_per_scene=5&speed_m_s=4&lidar=hdl-32e",
    {
        "extractor": "depth/dense-edges",
        "matcher": "nearest",
        "solver": "lm",
        "init": "given",
        "accumulate": "poses",
    },
    {"pipeline.reach_px": 20, "accumulate.past": 2, "accumulate.future": 2},
    within=(0.35, 0.08),
    frames="2,7,12",
)
ALL = (INFORMATION, LINES, DENSE)
FAMILIES = pytest.mark.parametrize("family", ALL, ids=lambda family: family.file.removesuffix(".py"))


@pytest.fixture(scope="module", autouse=True)
def _all_plugins() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("P2O_PLUGINS", raising=False)
        yield


@pytest.fixture(autouse=True)
def _nothing_remembered() -> None:
    """What another test has left in this process would hide calls."""
    worker._features.values.clear()
    worker._frames.values.clear()
    worker._stages.clear()


@dataclass(frozen=True)
class Bench:
    """A folder with a store and a cache, for studies of one family."""

    root: Path
    family: Family

    def study(self, more: str = "", out: str = "out") -> Ablation:
        """Run the study of the family and return what it came to."""
        worker._features.values.clear()
        worker._stages.clear()
        text = self.family.study(more)
        plugins = Plugins(files=(str(self.family.path),))
        cache_of_features = FeatureCache(self.root / "cache")
        file = StudyFile(parse_study(text), text, "test")
        return ablate(file, self.root / out, plugins=plugins, workers=Workers(1), cache=cache_of_features)


def ran(family: Family, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    main([*family.shell(), *more])
    [result] = json.loads(capsys.readouterr().out)["results"]
    return dict(result)


@FAMILIES
def test_a_run_ends_near_the_truth(family: Family, capsys: pytest.CaptureFixture[str]) -> None:
    result = ran(family, capsys)
    assert result["status"] in ("converged", "rounds-spent")
    for size, most in zip(("rotation_deg", "translation_m"), family.within, strict=True):
        assert result["error"][size] < min(most, result["start_error"][size]), size


def test_joined_sweeps_calibrate_where_a_single_one_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    joined = ran(DENSE, capsys)
    single = ran(DENSE, capsys, "--set", "accumulate.past=0", "--set", "accumulate.future=0")
    assert sum(joined["matches"].values()) > sum(single["matches"].values())
    assert joined["error"]["rotation_deg"] < 0.35 < single["error"]["rotation_deg"]


def test_sweeps_are_joined_as_well_by_poses_that_they_tell_themselves(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    result = ran(DENSE, capsys, "--accumulate", "gicp")
    assert result["error"]["rotation_deg"] < DENSE.within[0]
    assert result["error"]["translation_m"] < DENSE.within[1]


def test_a_method_of_dense_clouds_is_refused_single_sweeps_before_any_data_are_read(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = {word: value for word, value in DENSE.words.items() if word != "accumulate"}
    assert main(replace(DENSE, words=words, options={}).shell()) == 2
    assert "synthetic gives no dense; dense-edges needs it" in capsys.readouterr().err


@FAMILIES
def test_a_study_is_computed_once_and_takes_its_features_from_the_cache(
    family: Family, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, family)
    first = bench.study()
    assert (first.computed, len(first.rows), first.missing) == (2, 2, [])
    for row in first.rows:
        assert row.solved, row.exception or row.reason
        assert row.rotation_deg is not None
        assert row.translation_m is not None
        assert row.rotation_deg < family.within[0]
        assert row.translation_m < family.within[1]
    assert bench.study().computed == 0

    monkeypatch.setattr(guard, "build", without_extractors(guard.build))
    again = bench.study(out="elsewhere")
    assert again.computed == 2
    assert [row.estimate.tolist() for row in again.rows] == [row.estimate.tolist() for row in first.rows]


def without_extractors(build: Callable[[Offer, p2o.Options], Any]) -> Callable[[Offer, p2o.Options], Any]:
    """Return what builds stages, but extractors that find nothing and raise."""

    def built(offer: Offer, options: p2o.Options) -> Any:
        def refuse(data: Any) -> Any:
            raise AssertionError(f"{offer.name} is asked again")

        return refuse if offer.kind in (Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR) else build(offer, options)

    return built


@pytest.mark.parametrize("check", [pytest.param(case, id=case.name) for family in ALL for case in family.checks()])
def test_conformance(check: Case) -> None:
    check()


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_a_family_is_one_short_file_that_uses_public_names_of_p2o_only(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 150
    assert list(private_names(Source(file, text, f"p2o_plugins.{file.stem}"))) == []
