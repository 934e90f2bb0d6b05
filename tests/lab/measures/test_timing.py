"""What a processor time counts."""

import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from feasigrasp_lab.measures.timing import cpu_ms


def blas_threads():
    return [found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"]


def test_one_thread_is_timed_and_the_others_come_back():
    """Spinning threads of a library would be counted."""
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        inside, spent = cpu_ms(blas_threads)
        assert set(inside) == {1} and before == blas_threads() != inside
    assert spent >= 0.0


def test_sleep_costs_nothing_and_work_its_time():
    _, asleep = cpu_ms(lambda: time.sleep(0.05))
    assert asleep < 20.0

    def work():
        start = time.thread_time()
        while time.thread_time() - start < 0.05:
            np.linalg.norm(np.ones(100))

    _, spent = cpu_ms(work)
    assert spent == pytest.approx(50.0, abs=15.0)
