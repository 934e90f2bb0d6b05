"""LAPACK by its addresses, against NumPy."""

import threading
import time

import numpy as np
import pytest

from feasigrasp.models.numerics.lapack import factorize, solve_factorized, solve_lower


@pytest.fixture
def system():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(40, 40))
    return A @ A.T + np.eye(40), rng.normal(size=(40, 7))


@pytest.mark.parametrize("n", [1, 2, 40])
@pytest.mark.parametrize("m", [1, 7])
def test_routines_equal_numpy(system, n, m):
    A, B = system[0][:n, :n], system[1][:n, :m]
    L, x, half = (np.array(M, order="F") for M in (A, B, B))
    assert factorize(L) == 0
    np.testing.assert_allclose(np.tril(L), np.linalg.cholesky(A), atol=1e-12)
    solve_factorized(L, x)
    np.testing.assert_allclose(A @ x, B, atol=1e-11)
    solve_lower(L, half)
    np.testing.assert_allclose(np.tril(L) @ half, B, atol=1e-12)


def test_a_block_of_a_larger_matrix_is_enough(system):
    A, _ = system
    whole = np.zeros((60, 60), order="F")
    whole[15:55, 15:55] = A
    before = whole.copy()
    assert factorize(whole[15:55, 15:55]) == 0
    np.testing.assert_allclose(np.tril(whole[15:55, 15:55]), np.linalg.cholesky(A), atol=1e-12)
    before[15:55, 15:55] = whole[15:55, 15:55]
    np.testing.assert_array_equal(whole, before)


def test_what_cannot_be_done_is_refused(system):
    A, B = system
    indefinite = np.asfortranarray(A - 1e3 * np.eye(40))
    assert factorize(indefinite) == 1
    with pytest.raises(ValueError, match="Fortran"):
        factorize(A[:, ::2][:20].copy())
    with pytest.raises(ValueError, match="shape"):
        factorize(np.zeros((3, 4), order="F"))
    with pytest.raises(ValueError, match="right-hand"):
        solve_lower(np.asfortranarray(A), np.asfortranarray(B[:10]))
    frozen = np.asfortranarray(A)
    frozen.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        factorize(frozen)
    with pytest.raises(ArithmeticError, match="diagonal"):
        solve_lower(np.zeros((3, 3), order="F"), np.ones((3, 2), order="F"))


def test_other_threads_run_meanwhile():
    L, B = np.eye(1200, order="F"), np.ones((1200, 1200), order="F")
    span = []

    def work():
        span.append(time.perf_counter())
        solve_lower(L, B)
        span.append(time.perf_counter())

    thread = threading.Thread(target=work)
    thread.start()
    ticks = []
    while thread.is_alive():
        ticks.append(time.perf_counter())
        time.sleep(1e-4)
    start, end = span
    middle = [t for t in ticks if start + 0.3 * (end - start) < t < start + 0.7 * (end - start)]
    assert middle, "the lock was held"
