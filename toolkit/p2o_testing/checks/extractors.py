"""What extractors promise of every kind of feature that they give, their plugin's own ones among them."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.errors import P2OError
from p2o.features.feature import CloudFeature, Feature
from p2o.geometry import se3
from p2o.host.method import Kind

from p2o_testing import stage
from p2o_testing.same import Call, arrays_of, difference, require_equal, require_kept
from p2o_testing.subject import Checks, NotApplicable, Subject, but, gives, require

CHECKS = Checks(Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR)
IMAGES, CLOUDS = Checks(Kind.IMAGE_EXTRACTOR), Checks(Kind.CLOUD_EXTRACTOR)

_STEP = se3.exp(np.array([0.3, -0.2, 0.5, 2.0, -1.0, 0.7]))
_EXACT = 1e-9
"""Metres, for places a few tens of metres away: rounding is a thousand times smaller."""


def seen(subject: Subject) -> Any:
    """Return the part of a frame that the method looks at."""
    frame = subject.frames[0]
    return frame.image if subject.offer.kind == Kind.IMAGE_EXTRACTOR else frame.cloud


def look(subject: Subject) -> Call:
    """Return the call of the method on its frame."""
    return Call.of(subject, seen(subject))


def nothing(subject: Subject) -> Any:
    """Return what the method finds in an image or a sweep without features."""
    is_image = subject.offer.kind == Kind.IMAGE_EXTRACTOR
    return subject.built()(stage.featureless_image() if is_image else stage.featureless_cloud())


def _kinds(subject: Subject) -> Iterator[tuple[str, Any]]:
    """Return each kind of feature that was found, with its word; NotApplicable where nothing was found at all."""
    kinds = [(feature.word, feature) for feature in subject.once(look).answer if len(feature)]
    if not kinds:
        raise NotApplicable("it finds nothing in the frame: name frames in which it does in Method.example")
    yield from kinds


_image_edges, _cloud_edges = gives("image-edges"), gives("cloud-edges")
_of_other_kinds = but(gives("image-edges", "cloud-edges"))


@CHECKS.of()
def features_are_those_that_are_given(subject: Subject) -> None:
    """All kinds of features that `gives` names are there, and no others."""
    sensor = "image-" if subject.offer.kind == Kind.IMAGE_EXTRACTOR else "cloud-"
    declared = {word for word in subject.gives if word.startswith(sensor)}
    require(declared, f"`gives` names no kind of feature: it must say {sensor}..., as the word of the kind does")
    more = subject.once(look).answer.words - declared
    require(not more, f"it finds {', '.join(sorted(more))}, of which `gives` does not tell")


@CHECKS.of(_of_other_kinds)
@IMAGES.of(_image_edges, "image_edges_repeat")
@CLOUDS.of(_cloud_edges, "cloud_edges_repeat")
def features_repeat(subject: Subject) -> None:
    """The same input gives the same features, bit for bit, also from a freshly built stage."""
    subject.once(look).require_repeated(subject, "features")


@CHECKS.of(lambda method: method.parallel)
def calls_at_once_find_the_same(subject: Subject) -> None:
    """A method that says `parallel` finds the same when several threads ask it at once."""
    stage_of, data = subject.built(), seen(subject)
    with ThreadPoolExecutor(2) as pool:
        for features in pool.map(stage_of, [data] * 2):
            require_equal(subject.once(look).answer, features, "the features of calls at once differ")


@CHECKS.of(_of_other_kinds)
@IMAGES.of(_image_edges, "image_input_is_unchanged")
@CLOUDS.of(_cloud_edges, "cloud_input_is_unchanged")
def extractor_input_is_unchanged(subject: Subject) -> None:
    """The image or sweep is not written to."""
    subject.once(look).require_unwritten()


@CHECKS.of(_of_other_kinds)
def a_featureless_input_is_no_crash(subject: Subject) -> None:
    """One grey, or the inside of a ball, gives no error, and no more features than the frame."""
    for feature in subject.once(nothing):
        usual = subject.once(look).answer.get(feature.word)
        require(len(feature) <= len(usual), f"{len(feature)} {feature.word} where there are none to be found")


@IMAGES.of(_image_edges, "a_featureless_image_has_no_edges")
@CLOUDS.of(_cloud_edges, "a_featureless_cloud_has_no_edges")
def a_featureless_input_has_no_edges(subject: Subject) -> None:
    """An image of one grey and one depth, or a sweep of the inside of a ball, gives no edges, and no error."""
    edges = subject.once(nothing).edges
    require(len(edges) == 0, f"{len(edges)} edges where there are none to be found")


@CHECKS.of()
def features_survive_the_cache(subject: Subject) -> None:
    """Features can be kept: what is read from the cache is what was found."""
    for word, feature in _kinds(subject):
        require_kept(feature, word)


@CHECKS.of()
def forgetting_sides_keeps_every_feature(subject: Subject) -> None:
    """Features without their directions keep number and kind, and removing directions twice changes nothing more."""
    for word, feature in _kinds(subject):
        bare = feature.without_sides()
        require(type(bare) is type(feature), f"{word} without sides are {type(bare).__name__}")
        require(len(bare) == len(feature), f"{len(feature)} {word}, {len(bare)} without sides")
        require_equal(bare, bare.without_sides(), f"{word} forget more the second time")


@CHECKS.of()
def selected_features_are_some_of_them(subject: Subject) -> None:
    """A mask and an index select the same features, all of them are all, and `thinned(n)` leaves at most n of them.

    Kinds without rows (maps) return themselves.
    """
    for word, feature in _kinds(subject):
        _require_selection(word, feature)


def _require_selection(word: str, feature: Feature) -> None:
    count = len(feature)
    keep = np.zeros(count, np.bool_)
    keep[: -(-count // 2)] = True
    half = feature.select(keep)
    if difference(half, feature) == "" and count > 1:
        require_equal(feature, feature.thinned(1), f"{word} have no rows to select, but thin out")
        return
    require(len(half) == keep.sum(), f"a mask of {keep.sum()} {word} selects {len(half)}")
    require_equal(half, feature.select(np.flatnonzero(keep)), f"mask and index select other {word}")
    require_equal(feature, feature.select(np.ones(count, np.bool_)), f"{word} differ when all are selected")
    for most in {0, 1, count // 3, count}:
        thin = feature.thinned(most)
        require(len(thin) <= most, f"thinned({most}) leaves {len(thin)} {word}")
        _require_rows_of(word, thin, feature)
    require(len(feature.thinned(count)) == count, f"thinned({count}) loses some of {count} {word}")


def _require_rows_of(word: str, some: Feature, feature: Feature) -> None:
    """Raise CheckFailed where a row of `some` is none of `feature`; arrays with one row a feature are looked at."""
    whole = arrays_of(feature)
    for name, rows in arrays_of(some).items():
        known = whole.get(name)
        if known is None or not len(rows) or len(known) != len(feature) or len(rows) != len(some):
            continue
        known_rows = {row.tobytes() for row in np.ascontiguousarray(known)}
        lost = sum(row.tobytes() not in known_rows for row in np.ascontiguousarray(rows))
        require(not lost, f"{lost} of the thinned {word} are none of the features: {name}")


@CLOUDS.of()
def features_move_rigidly(subject: Subject) -> None:
    """Features in another frame are where a rigid transform puts them: there and back, and in two steps as in one."""
    for word, feature in _kinds(subject):
        moved = feature.moved(_STEP)
        require(type(moved) is type(feature), f"moved {word} are {type(moved).__name__}")
        require(len(moved) == len(feature), f"{len(feature)} {word}, {len(moved)} moved ones")
        require(difference(moved, feature), f"{word} do not move at all")
        _require_places(word, moved, None if feature.places is None else se3.apply(_STEP, feature.places), "moved")
        _require_close(word, moved.moved(se3.inverse(_STEP)), feature, "moved there and back")
        _require_close(word, moved.moved(_STEP), feature.moved(_STEP @ _STEP), "moved in two steps and in one")
        _require_close(word, feature.moved(np.eye(4)), feature, "moved by nothing")


@CLOUDS.of()
def features_untwist_by_their_times(subject: Subject) -> None:
    """A LiDAR that stands leaves features as they are; one that drives straight on shifts each by its own time."""
    velocity = np.array([9.0, -2.0, 0.5])
    for word, feature in _kinds(subject):
        _require_close(word, feature.untwisted(np.zeros(6)), feature, "of a LiDAR that stands")
        driven = feature.untwisted(np.concatenate([np.zeros(3), velocity]))
        require(len(driven) == len(feature), f"{len(feature)} {word}, {len(driven)} of a LiDAR that drives")
        times_s, places = feature.times_s, feature.places
        if times_s is None:
            _require_close(word, driven, feature, "without times")
        elif places is not None and len(places) == len(times_s):
            _require_places(word, driven, places + np.outer(times_s, velocity), "of a LiDAR that drives")


@CLOUDS.of()
def a_single_point_is_no_crash(subject: Subject) -> None:
    """A sweep of one point gives no edges and next to nothing else, or is refused with a P2OError."""
    try:
        features = subject.built()(subject.frames[0].cloud.select(np.array([0])))
    except P2OError as problem:
        require("raised" not in str(problem), str(problem))
        return
    for feature in features:
        most = 0 if feature.word == "cloud-edges" else 1
        require(len(feature) <= most, f"{len(feature)} {feature.word} on a sweep of one point")


def _require_places(word: str, feature: CloudFeature, places: Float | None, how: str) -> None:
    own = feature.places
    require((own is None) == (places is None), f"{word} {how} lose their places")
    if own is not None and places is not None:
        require(np.shape(own) == np.shape(places), f"{word} {how} have other places: {np.shape(own)}")
        off = float(np.abs(own - places).max())
        require(off <= _EXACT, f"{word} {how} are {off:.3g} m from where they belong")


def _require_close(word: str, one: Feature, other: Feature, how: str) -> None:
    """Raise CheckFailed where a number differs by more than rounding."""
    first, second = arrays_of(one), arrays_of(other)
    require(first.keys() == second.keys(), f"{word} {how} have other fields")
    for name, array in first.items():
        require(array.shape == second[name].shape, f"{word} {how} have another shape: {name}")
        same = np.allclose(array, second[name], rtol=0, atol=_EXACT, equal_nan=True)
        require(same, f"{word} {how} differ: {name}")
