"""A check is one promise of a method; its subject is the method with its options and the frames to run it on."""

from __future__ import annotations

import unittest
from collections.abc import Callable, Set
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, TypeVar

from p2o.frames.frame import Frame
from p2o.host.guard import build
from p2o.host.method import Example, Kind, Method
from p2o.host.registry import Offer, Plugin, Registry
from p2o.options import Options
from p2o.run.fit import FRAME_CONTENT
from p2o.run.joined import JoinedFrames
from p2o.run.recipe import open_dataset

from p2o_testing import stage

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
    _computed: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)

    def built(self) -> Any:
        """Return a freshly built stage."""
        return build(self.offer, self.options)

    def once(self, find: Callable[[Subject], T]) -> T:
        """Return the value of `find` for this subject, computed once for all checks."""
        if find not in self._computed:
            self._computed[find] = find(self)
        value: T = self._computed[find]
        return value

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
        """The frames on which the method promises to succeed, if the stage is not suitable."""
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
        if missing := lacking(self.needs, frames):
            others = "frames that do" if self.example is None else "others"
            raise NotApplicable(f"the frames have no {missing[0]}, which it needs: name {others} in Method.example")
        return frames


def lacking(needs: Set[str], frames: tuple[Frame, ...]) -> list[str]:
    """Return the needed content that one of the frames does not have."""
    words = sorted(needs & FRAME_CONTENT.keys())
    return [word for word in words if any(FRAME_CONTENT[word](frame) is None for frame in frames)]


def _installed(_: Subject) -> Registry:
    return Registry.load()


def frames_of(subject: Subject) -> tuple[Frame, ...]:
    """Return the frames of the example, else the stage, or the drive through it if the stage is not suitable."""
    if subject.example is not None:
        return _frames_of_example(subject.example.data, subject.example.accumulate, subject.registry)
    one = (stage.frame(),)
    return stage.drive() if lacking(subject.needs, one) else one


@lru_cache(maxsize=1)
def _frames_of_example(data: str, accumulate: str, registry: Registry) -> tuple[Frame, ...]:
    """Return the frames of an example; methods with the same example share them, and what is cached by sweep."""
    frames: Any = open_dataset(data, registry)
    if accumulate:
        joins = registry.find(Kind.ACCUMULATOR, accumulate)
        frames = JoinedFrames(frames, build(joins, joins.method.options()))
    return tuple(frames[:])


When = Callable[[Method], bool]
Test = Callable[[Subject], None]

_IMPLIED = {"pairs": {"pairs"}, "residuals": {"residuals", "pairs"}, "objective": {"objective", "residuals", "pairs"}}
"""Content that implies other content: pairs are a least-squares problem, which has a cost."""


def always(method: Method) -> bool:
    """Every method of the kinds."""
    return True


def gives(*words: str) -> When:
    """Methods that give one of the words; residuals are given with pairs, an objective with both."""
    wanted = set().union(*(_IMPLIED.get(word, {word}) for word in words))
    return lambda method: not wanted.isdisjoint(method.gives)


def needs(*words: str) -> When:
    """Methods that need one of the words."""
    return lambda method: not method.needs.isdisjoint(words)


def but(when: When) -> When:
    """All other methods."""
    return lambda method: not when(method)


def both(*conditions: When) -> When:
    """Methods of which all conditions hold."""
    return lambda method: all(when(method) for when in conditions)


@dataclass(frozen=True)
class Check:
    """One promise: `name`, the `kinds` of method that make it, the function that tests it, and of those kinds `when`.

    The function takes a `Subject` and raises CheckFailed where the promise is broken. Its docstring is the promise.
    """

    name: str
    kinds: frozenset[Kind]
    function: Callable[[Subject], None]
    when: When = always

    @property
    def promise(self) -> str:
        """The promise in a sentence."""
        return (self.function.__doc__ or "").split("\n", maxsplit=1)[0]

    def is_for(self, kind: Kind, method: Method) -> bool:
        """Return whether a method of a kind makes this promise, by what it needs and gives."""
        return kind in self.kinds and self.when(method)


class Checks(list[Check]):
    """The checks of one module, in its order; a function becomes one by the decorator `of`."""

    def __init__(self, *kinds: Kind) -> None:
        super().__init__()
        self._kinds = frozenset(kinds)

    def of(self, when: When = always, name: str = "") -> Callable[[Test], Test]:
        """Register a function as a check of the methods of the kinds for which `when` holds."""

        def note(function: Test) -> Test:
            self.append(Check(name or function.__name__, self._kinds, function, when))
            return function

        return note
