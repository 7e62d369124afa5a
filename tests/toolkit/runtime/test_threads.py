"""Work on several frames: in their order, with the first error, whatever the number of cores."""

from __future__ import annotations

import threading

import pytest
from p2o.runtime.native import cores, for_each


@pytest.fixture(params=[1, 3])
def core_count(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("p2o.runtime.native.cores", lambda: request.param)
    return request.param


def test_results_come_in_the_order_of_what_is_given(core_count: int) -> None:
    meet = threading.Barrier(core_count, timeout=20)

    def work(number: int) -> int:
        if number < core_count:  # so many are at work at once
            meet.wait()
        return number * number

    assert for_each(work, range(7), parallel=True) == [number * number for number in range(7)]
    assert set(for_each(lambda _: threading.get_ident(), range(5), parallel=False)) == {threading.get_ident()}


def test_the_first_error_is_told_however_many_fail(core_count: int) -> None:
    def work(number: int) -> int:
        if number in (2, 4):
            raise ValueError(f"bad {number}")
        return number

    with pytest.raises(ValueError, match="bad 2"):
        for_each(work, range(6), parallel=True)


def test_omp_num_threads_bounds_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert cores() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "100000")
    assert cores() < 100000
    monkeypatch.setenv("OMP_NUM_THREADS", "")
    assert cores() >= 1


def test_what_uses_several_cores_by_itself_uses_one_in_each_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("p2o.runtime.native.cores", lambda: 2)
    alone = cores()
    assert for_each(lambda _: cores(), [1, 2, 3], parallel=True) == [1, 1, 1]
    assert for_each(lambda _: cores(), [1, 2, 3], parallel=False) == [alone] * 3
    assert cores() == alone
