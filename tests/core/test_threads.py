"""Work on threads."""

import threading

import pytest

from texfcodec.core.threads import ahead, in_order


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(threads):
    assert list(in_order(lambda v: v * v, range(20), threads)) == [v * v for v in range(20)]


def test_as_many_are_at_work_as_there_are_threads():
    together = threading.Barrier(3, timeout=20)
    assert list(in_order(lambda v: together.wait() >= 0, range(3), 3)) == [True] * 3


@pytest.mark.parametrize("threads", [1, 2])
def test_nothing_begins_once_the_caller_has_turned_away(threads):
    begun, free = [], threading.Event()

    def one(v):
        begun.append(v)
        if v:
            free.wait(20)

    made = in_order(one, range(50), threads)
    next(made)
    threading.Timer(0.5, free.set).start()
    made.close()
    assert len(begun) <= threads + 1


def test_what_fails_is_raised_where_its_result_would_be():
    made = in_order(lambda v: 1 // v, [1, 0, 1], 2)
    assert next(made) == 1
    with pytest.raises(ZeroDivisionError):
        next(made)


def test_what_is_made_ahead_is_made_once_and_beside_the_caller():
    begun, free, calls = threading.Event(), threading.Event(), []

    def make():
        calls.append(threading.current_thread())
        begun.set()
        assert free.wait(20)
        return 7

    made = ahead(make, 2)
    assert begun.wait(20)
    free.set()
    assert [made(), made()] == [7, 7] and len(calls) == 1 and calls[0] is not threading.current_thread()


def test_with_one_thread_it_is_made_when_it_is_asked_for():
    calls = []
    made = ahead(lambda: calls.append(1) or 7, 1)
    assert not calls and [made(), made()] == [7, 7] and calls == [1]
