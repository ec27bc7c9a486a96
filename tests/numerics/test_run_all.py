"""Work on many items by threads."""

import threading
import time

import pytest

from pointmr_engine.numerics.run_all import run_all


@pytest.mark.parametrize("threads", [1, 2, 7, None])
def test_each_item_is_worked_on_once(threads):
    seen = []
    run_all(lambda a, b: seen.append((a, b)), [(k, -k) for k in range(20)], threads)
    assert sorted(seen) == [(k, -k) for k in range(20)]


@pytest.mark.parametrize(("threads", "same"), [(1, True), (2, False)])
def test_one_thread_is_this_one_and_more_are_others(threads, same):
    names = set()
    run_all(lambda: names.add(threading.get_ident()), [()] * 4, threads)
    assert (threading.get_ident() in names) == same


@pytest.mark.parametrize("threads", [1, 3])
def test_what_work_raises_is_raised_and_what_waits_is_left(threads):
    done = []

    def work(k):
        if k == 0:
            raise ValueError("the first")
        time.sleep(0.01)
        done.append(k)

    with pytest.raises(ValueError, match="the first"):
        run_all(work, [(k,) for k in range(200)], threads)
    assert len(done) < 100


@pytest.mark.parametrize("threads", [1, 3])
def test_progress_may_cancel(threads):
    done = []

    def progress(fraction: float) -> None:
        if fraction > 0.1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_all(lambda k: (time.sleep(0.01), done.append(k)), [(k,) for k in range(200)], threads, progress)
    assert 10 < len(done) < 190


def test_nothing_is_nothing():
    calls = []
    run_all(calls.append, [], 2, calls.append)
    assert not calls
