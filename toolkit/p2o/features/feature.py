"""Base classes of kinds of features, from which plugins derive their own, and sets of features."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError


class Feature:
    """One kind of feature of one image or sweep; derive a frozen dataclass from `ImageFeature` or `CloudFeature`.

    `word` names the kind (image-edges, cloud-points, ...) in `gives` of extractors, `needs` of matchers and views. A
    kind of length 0 counts as missing. All methods return a new value.
    """

    word: ClassVar[str]

    def __len__(self) -> int:
        raise TypeError(f"{type(self).__name__} does not define __len__, the number of features")

    def without_sides(self) -> Self:
        """Return the features without directions; the same object if they have none."""
        return self

    def select(self, keep: Any) -> Self:
        """Return the features of a mask or index; kinds without rows return themselves."""
        return self

    def thinned(self, most: int) -> Self:
        """Return at most `most` of the features, evenly spaced in their order."""
        count = len(self)
        if count <= most:
            return self
        return self.select(np.linspace(0, count - 1, max(most, 0)).round().astype(np.int64))


class ImageFeature(Feature):
    """A kind of feature in image coordinates, independent of the LiDAR frame."""


class CloudFeature(Feature):
    """A kind of feature in the LiDAR frame, in metres, which defines its transformation."""

    def moved(self, b_from_lidar: Float) -> Self:
        """Return the features in another frame b, by a (4, 4) rigid transform."""
        raise TypeError(f"{type(self).__name__} does not define moved, its transformation")

    def untwisted(self, twist: Float) -> Self:
        """Return the features as observed at time 0 from a LiDAR that moves with constant `twist` (6,), rad/s and m/s.

        Kinds without times return themselves.
        """
        return self

    @property
    def times_s(self) -> Float | None:
        """Time in s of each feature of a raw sweep relative to the image; None for kinds without times."""
        return None

    @property
    def places(self) -> Float | None:
        """Positions (N, 3) m of the features, for visibility checks; None if visibility is not checked."""
        return None


F = TypeVar("F", bound=Feature)


class FeatureSet(Generic[F]):
    """The features of one image or sweep, at most one of each kind, accessed by its word."""

    features: tuple[F, ...]

    def get(self, word: str) -> Any:
        """Return the features of a kind, None if there are none."""
        return next((feature for feature in self.features if feature.word == word), None)

    def __iter__(self) -> Iterator[F]:
        return iter(self.features)

    @property
    def words(self) -> frozenset[str]:
        """The words of the kinds."""
        return frozenset(feature.word for feature in self.features)

    def having(self, *features: F) -> Self:
        """Return the set with these features, which replace those of their kinds."""
        new = {feature.word for feature in features}
        return self._of((*(old for old in self.features if old.word not in new), *features))

    def mapped(self, change: Callable[[F], F]) -> Self:
        """Return the set with `change` applied to every feature."""
        return self._of(tuple(change(feature) for feature in self.features))

    def without_sides(self) -> Self:
        """Return the features without directions."""
        return self.mapped(lambda feature: feature.without_sides())

    def thinned(self, most: int) -> Self:
        """Return the set with at most `most` features of each kind."""
        return self.mapped(lambda feature: feature.thinned(most))

    def _of(self, features: tuple[F, ...]) -> Self:
        return type(self)(features=features)  # type: ignore[call-arg]


def checked_kinds(features: Any, wanted: type[Feature], sensor: str) -> tuple[Any, ...]:
    """Return features as a tuple ordered by word; raises InputError for other types and two features of one kind."""
    checked = tuple(features)
    for feature in checked:
        if not isinstance(feature, wanted) or not isinstance(getattr(feature, "word", None), str):
            expected = f"p2o.{wanted.__name__} with a `word`"
            raise InputError(f"expected a feature of the {sensor}", expected=expected, got=type(feature).__name__)
    words = [feature.word for feature in checked]
    if len(set(words)) < len(words):
        twice = next(word for i, word in enumerate(words) if word in words[:i])
        raise InputError(f"two features of the {sensor} are of the kind {twice}", expected="each kind once")
    return tuple(sorted(checked, key=lambda feature: feature.word))
