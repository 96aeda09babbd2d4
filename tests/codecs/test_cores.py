"""Tasks done ahead give what they give one by one, and no more is done than was asked for."""

from __future__ import annotations

from functools import partial

import pytest

from groundtrace_codecs import cores
from groundtrace_codecs.cores import ahead

pytestmark = pytest.mark.parametrize("count", [1, 2], ids=["one core", "two cores"])


@pytest.fixture(autouse=True)
def some_cores(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let there be so many cores."""
    monkeypatch.setattr(cores, "cores", lambda: count)


def test_results_come_in_the_order_of_their_tasks():
    tasks = [partial(pow, 2, n) for n in range(7)]
    assert list(ahead(tasks)) == [2**n for n in range(7)]
    assert list(ahead(tasks[:1])) == [1]
    assert list(ahead([])) == []


def test_one_that_is_looked_at_alone_is_done_alone():
    done: list[int] = []
    results = ahead(partial(done.append, n) for n in range(5))
    assert done == []
    next(results)
    assert done == [0]
    results.close()
    assert done == [0]


def test_no_more_than_two_are_done_ahead(count: int):
    begun: list[int] = []
    results = ahead(partial(begun.append, n) for n in range(9))
    for asked in range(1, 6):
        next(results)
        assert asked <= len(begun) <= asked + 2 * (count > 1)


def test_an_error_is_raised_where_its_task_is_due():
    results = ahead([int, int, partial(divmod, 1, 0), int])
    assert [next(results), next(results)] == [0, 0]
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_tasks_of_several_take_turns():
    pairs = zip(ahead([int] * 5), ahead([float] * 5), strict=True)
    assert list(pairs) == [(0, 0.0)] * 5
