"""What a check is given: a method with its options, the frames to try it on, and the methods installed beside it."""

from __future__ import annotations

import unittest
from collections.abc import Callable, Set
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from p2o.frames.frame import Frame
from p2o.host.guard import build
from p2o.host.method import Example, Kind
from p2o.host.registry import Offer, Plugin, Registry
from p2o.options import Options
from p2o.run.fit import HELD
from p2o.run.joined import JoinedFrames
from p2o.run.recipe import open_dataset
from p2o.testing import stage

T = TypeVar("T")


class CheckFailed(AssertionError):  # noqa: N818  (a verdict on a plugin, not a defect here)
    """A method breaks a promise of its slot."""


class NotApplicable(unittest.SkipTest):
    """A check cannot be made of this method here: there are no frames or features for it."""


def require(condition: Any, message: str) -> None:
    """Raise CheckFailed with the message unless the condition holds."""
    if not condition:
        raise CheckFailed(message)


@dataclass(frozen=True)
class Subject:
    """A method under test with its options; `known` are the methods that may serve it, by default all installed."""

    offer: Offer
    options: Options
    known: Registry | None = field(default=None, compare=False, repr=False)
    _found: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)

    def built(self) -> Any:
        """Return a freshly built stage."""
        return build(self.offer, self.options)

    def once(self, find: Callable[[Subject], T]) -> T:
        """Return what `find` finds of this subject; it is looked for once, for all checks."""
        if find not in self._found:
            self._found[find] = find(self)
        found: T = self._found[find]
        return found

    @property
    def gives(self) -> frozenset[str]:
        """The words that the method gives."""
        return frozenset(self.offer.method.gives)

    @property
    def needs(self) -> frozenset[str]:
        """The words that the method needs."""
        return frozenset(self.offer.method.needs)

    @property
    def example(self) -> Example | None:
        """The frames on which the method promises to succeed, where the stage will not do."""
        return self.offer.method.example

    @property
    def registry(self) -> Registry:
        """The methods that may serve this one, itself among them."""
        known = self.once(_installed) if self.known is None else self.known
        if self.offer in known.offers:
            return known
        own = Plugin(self.offer.dist, self.offer.version, self.offer.entry, (self.offer,))
        return replace(known, plugins=(own, *known.plugins))

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The frames to try the method on: those of its example, else the stage, or the drive through it.

        Raises NotApplicable where they lack what the method needs.
        """
        frames = self.once(frames_of)
        missing = lacking(self.needs, frames)
        if missing:
            raise NotApplicable(f"the frames have no {missing[0]}, which it needs: {_advice(self.example)}")
        return frames


def lacking(needs: Set[str], frames: tuple[Frame, ...]) -> list[str]:
    """Return the needed words that one of the frames does not hold."""
    return [word for word in sorted(needs & HELD.keys()) if any(HELD[word](frame) is None for frame in frames)]


def _installed(_: Subject) -> Registry:
    return Registry.load()


def frames_of(subject: Subject) -> tuple[Frame, ...]:
    """Return the frames of the example, else the stage, or the drive through it where the stage will not do."""
    example = subject.example
    if example is not None:
        frames: Any = open_dataset(example.data, subject.registry)
        if example.accumulate:
            joins = subject.registry.find(Kind.ACCUMULATOR, example.accumulate)
            frames = JoinedFrames(frames, build(joins, joins.method.options()))
        return tuple(frames[:])
    one = (stage.frame(),)
    return stage.drive() if lacking(subject.needs, one) else one


def _advice(example: Example | None) -> str:
    return "name others in Method.example" if example is not None else "name frames that do in Method.example"
