"""Which stages of a plan prepare something of frames that a study keeps."""

from __future__ import annotations

from p2o import Recipe, Registry
from p2o_study.worker import prepared_stages


def stages(**words: str) -> tuple[str, ...]:
    words = {"extractor": "canny/rings", "matcher": "nearest", "witness": "none", **words}
    return prepared_stages(Recipe.of(data=None, **words).resolve(Registry.load()))


def test_an_initializer_counts_where_it_prepares_frames() -> None:
    assert set(stages(init="given")) == {"extractor", "cloud"}
    plan = Recipe.of(
        data=None,
        extractor="canny/rings",
        matcher="nearest",
        init="hand-eye",
        witness="none",
        options={"init": {"lidar": "given"}},
    ).resolve(Registry.load())
    assert set(prepared_stages(plan)) == {"extractor", "cloud", "init"}
