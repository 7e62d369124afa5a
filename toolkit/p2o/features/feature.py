"""Kinds of features: what a plugin derives from to bring one of its own, and the sets that extractors give."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError


class Feature:
    """One kind of feature of one image or sweep; derive a frozen dataclass of arrays from a subclass of this.

    `word` names the kind (image-edges, cloud-points, ...): extractors give it, matchers need it, views find features by
    it. A kind that holds nothing (`len` 0) counts as not found. All methods return a new value.
    """

    word: ClassVar[str]

    def __len__(self) -> int:
        raise TypeError(f"{type(self).__name__} does not say how many features it holds: define __len__")

    def without_sides(self) -> Self:
        """Return the features with every direction forgotten; the same where they have none."""
        return self

    def select(self, keep: Any) -> Self:
        """Return the features of a mask or index; kinds without rows return themselves."""
        return self

    def thinned(self, most: int) -> Self:
        """Return at most `most` of the features, spread evenly over their order."""
        count = len(self)
        if count <= most:
            return self
        return self.select(np.linspace(0, count - 1, max(most, 0)).round().astype(np.int64))


class ImageFeature(Feature):
    """A kind of feature that lies in the image: it does not move with the LiDAR frame."""


class CloudFeature(Feature):
    """A kind of feature that lies in the LiDAR frame, in metres: it says how it moves with it."""

    def moved(self, b_from_lidar: Float) -> Self:
        """Return the features in another frame b, by a (4, 4) rigid transform."""
        raise TypeError(f"{type(self).__name__} does not say how it moves: define moved")

    def untwisted(self, twist: Float) -> Self:
        """Return the features as if seen at time 0 from a LiDAR that moves with constant `twist` (6,), rad/s and m/s.

        Kinds without times return themselves.
        """
        return self

    @property
    def times_s(self) -> Float | None:
        """When each feature of a raw sweep was seen, in seconds from the image; None for kinds without times."""
        return None

    @property
    def places(self) -> Float | None:
        """Points (N, 3) m of the features, to tell whether a camera can see any; None where it does not matter."""
        return None


F = TypeVar("F", bound=Feature)


class FeatureSet(Generic[F]):
    """The features of one image or sweep: each kind at most once, found by its word."""

    features: tuple[F, ...]

    def get(self, word: str) -> Any:
        """Return the features of a kind, or None where the extractor gave none."""
        return next((feature for feature in self.features if feature.word == word), None)

    def __iter__(self) -> Iterator[F]:
        return iter(self.features)

    @property
    def words(self) -> frozenset[str]:
        """The kinds that are there."""
        return frozenset(feature.word for feature in self.features)

    def having(self, *features: F) -> Self:
        """Return the set with these features, each in the place of the one of its kind."""
        new = {feature.word for feature in features}
        return self._of((*(old for old in self.features if old.word not in new), *features))

    def mapped(self, change: Callable[[F], F]) -> Self:
        """Return the set with every feature changed."""
        return self._of(tuple(change(feature) for feature in self.features))

    def without_sides(self) -> Self:
        """Return the features with every direction forgotten."""
        return self.mapped(lambda feature: feature.without_sides())

    def thinned(self, most: int) -> Self:
        """Return the set with at most `most` features of each kind."""
        return self.mapped(lambda feature: feature.thinned(most))

    def _of(self, features: tuple[F, ...]) -> Self:
        return type(self)(features=features)  # type: ignore[call-arg]


def checked_kinds(features: Any, wanted: type[Feature], sensor: str) -> tuple[Any, ...]:
    """Return features as a tuple in the order of their words; InputError where one is none, or two are of one kind."""
    found = tuple(features)
    for feature in found:
        if not isinstance(feature, wanted) or not isinstance(getattr(feature, "word", None), str):
            raise InputError(
                f"a feature of the {sensor} is none",
                expected=f"p2o.{wanted.__name__} with a `word`",
                got=type(feature).__name__,
            )
    words = [feature.word for feature in found]
    if len(set(words)) < len(words):
        twice = next(word for i, word in enumerate(words) if word in words[:i])
        raise InputError(f"two features of the {sensor} are of the kind {twice}", expected="each kind once")
    return tuple(sorted(found, key=lambda feature: feature.word))
