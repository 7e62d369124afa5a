"""The same work on each of several frames or views: one after the other, or on all cores where the work allows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from p2o.native import cores, one_of_several

_Given = TypeVar("_Given")
_Made = TypeVar("_Made")


def for_each(work: Callable[[_Given], _Made], given: Sequence[_Given], *, parallel: bool) -> list[_Made]:
    """Return what `work` makes of each, in their order; in threads with `parallel`.

    An error is that of the first one that has any, however many fail. With one core nothing is different but the time.
    What uses several cores by itself uses one in each thread (`p2o.native.cores`).
    """
    threads = min(len(given), cores()) if parallel else 1
    if threads < 2:
        return [work(one) for one in given]
    import joblib

    def tried(one: _Given) -> _Made | Exception:
        try:
            with one_of_several():
                return work(one)
        except Exception as problem:
            return problem

    found = joblib.Parallel(n_jobs=threads, prefer="threads", batch_size=1)(joblib.delayed(tried)(one) for one in given)
    made: list[_Made] = []
    for one in found:
        if isinstance(one, Exception):
            raise one
        made.append(one)
    return made
