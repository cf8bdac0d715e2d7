"""Where work runs: each item once, what it raises, and that nothing is left of a cluster however it ends."""

import math
import multiprocessing
import operator
import os
import time

import pytest

from softdeca.lhm import SoftdecaError
from softdeca.surrogate.corpus.schedule import Schedule, make_schedule, run_items

# A function that travels to another process has to be importable there: these are functions of the standard library.
SERIAL, TWO = Schedule(), Schedule("processes", 2)


@pytest.mark.parametrize("on", [SERIAL, TWO], ids=["serial", "processes"])
def test_every_item_is_done_once(on):
    assert sorted(run_items(operator.neg, list(range(30)), on=on)) == [-k for k in range(29, -1, -1)]
    assert multiprocessing.active_children() == []


def test_an_existing_cluster_is_used_and_left_running():
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        on = make_schedule(7, cluster.scheduler_address)
        assert sorted(run_items(operator.neg, [1, 2, 3], on=on)) == [-3, -2, -1]
        assert len(cluster.workers) == 1


@pytest.mark.parametrize("on", [SERIAL, TWO], ids=["serial", "processes"])
def test_what_an_item_raises_ends_the_rest(on):
    with pytest.raises(ValueError, match="domain"):
        list(run_items(math.sqrt, [4.0, -1.0] + [4.0] * 1000, on=on))
    assert multiprocessing.active_children() == []


def test_a_worker_that_dies_each_time_is_named():
    with pytest.raises(SoftdecaError, match="^heads: a worker process died; run again"):
        list(run_items(os._exit, [3, 3], on=TWO, name="heads"))


def test_an_iterator_that_is_left_stops_its_workers():
    results = run_items(time.sleep, [0.0] * 8 + [600.0] * 100, on=TWO)
    next(results)
    results.close()
    assert multiprocessing.active_children() == []


def test_nothing_is_started_for_nothing():
    assert list(run_items(operator.neg, [], on=TWO)) == []
