"""One promise of a method, and for which methods it is: their kinds, and what they need and give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from p2o.host.method import Kind, Method
from p2o.testing.subject import Subject

When = Callable[[Method], bool]

_IMPLIED = {"pairs": {"pairs"}, "residuals": {"residuals", "pairs"}, "objective": {"objective", "residuals", "pairs"}}
"""What gives a word: pairs are a least squares, and that has a cost."""


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

    def of(self, when: When = always) -> Callable[[Callable[[Subject], None]], Callable[[Subject], None]]:
        """Note a function as a check of those methods of the kinds for which `when` holds."""

        def note(function: Callable[[Subject], None]) -> Callable[[Subject], None]:
            self.append(Check(function.__name__, self._kinds, function, when))
            return function

        return note
