"""BLAS is held to one thread where it is asked to, and given back."""

import threading

from numba.core import caching
from threadpoolctl import threadpool_info

from rtcal.support.speed import compiled, single_threaded_blas


def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_concurrent_contexts_give_the_threads_back():
    before, entered, leave = threads(), threading.Event(), threading.Event()

    def other():
        with single_threaded_blas():
            entered.set()
            leave.wait(10)

    thread = threading.Thread(target=other)
    with single_threaded_blas():
        thread.start()
        assert entered.wait(10)
        assert threads() == {1}
    leave.set()
    thread.join(10)
    assert threads() == before


def test_a_loop_is_compiled_where_no_folder_can_be_written(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert compiled(reorder=False)(lambda x: x + 1)(1.0) == 2.0
