"""The pool that corpus and campaign share: what it yields, and that nothing is left of it however it ends."""

import math
import multiprocessing
import operator
import os
import time
from collections import deque
from functools import partial

import pytest

from softdeca.lhm import SoftdecaError
from softdeca.surrogate.pool import results_of

# What travels to a spawned process has to be importable there: here functions of the standard library.
pytestmark = pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_every_item_is_done_once(workers):
    found = results_of(operator.neg, [3, 1, 2], workers=workers, name="test")
    assert sorted(found) == [-3, -2, -1]
    assert multiprocessing.active_children() == []


def test_nothing_begins_where_there_is_nothing_to_do():
    begun: deque[str] = deque()
    assert list(results_of(begun.count, [], workers=2, name="test", begin=partial(begun.append, "here"))) == []
    assert not begun


@pytest.mark.parametrize("workers", [1, 2])
def test_each_process_begins_once_and_first(workers):
    begun: deque[str] = deque()
    begin = partial(begun.append, "here")
    found = list(results_of(begun.count, ["here"] * 20, workers=workers, name="test", begin=begin))
    assert found == [1] * 20
    assert len(begun) == (workers == 1), "each process has its own copy"


@pytest.mark.parametrize("workers", [1, 2])
def test_what_an_item_raises_ends_the_rest(workers):
    with pytest.raises(ValueError, match="domain"):
        list(results_of(math.sqrt, [4.0, -1.0] + [4.0] * 1000, workers=workers, name="test"))
    assert multiprocessing.active_children() == []


def test_a_worker_that_dies_is_named():
    with pytest.raises(SoftdecaError, match="^test: a worker process died; run again"):
        list(results_of(os._exit, [3] * 100, workers=2, name="test"))
    assert multiprocessing.active_children() == []


def test_an_iterator_that_is_left_stops_its_workers_and_no_other_process():
    other = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    other.start()
    begin = time.monotonic()
    try:
        results = results_of(time.sleep, [0.0, *[60.0] * 100], workers=2, name="test")
        next(results)
        results.close()
        assert multiprocessing.active_children() == [other] and other.is_alive()
        assert time.monotonic() - begin < 30
    finally:
        other.kill()
        other.join()
