"""Cholesky's method for small matrices against LAPACK."""

import numpy as np
import pytest

from feasigrasp.models.numerics.small_cholesky import cholesky_kernel, cholesky_solve_kernel


@pytest.mark.parametrize("n", [1, 2, 6])
def test_factor_and_solution_are_those_of_lapack(n):
    rng = np.random.default_rng(n)
    root, b = rng.normal(size=(n, n)), rng.normal(size=n)
    A = root @ root.T + 0.1 * np.eye(n)
    L = np.tril(A) + np.triu(np.full((n, n), np.nan), 1)  # only the lower triangle counts
    cholesky_kernel(L, L, 0.0)
    np.testing.assert_allclose(np.tril(L), np.linalg.cholesky(A), atol=1e-12)
    x = b.copy()
    cholesky_solve_kernel(L, x)
    np.testing.assert_allclose(A @ x, b, atol=1e-11)


def test_small_pivots_are_raised():
    L = np.empty((2, 2))
    cholesky_kernel(np.ones((2, 2)), L, 1e-18)
    np.testing.assert_allclose(np.tril(L), [[1.0, 0.0], [1.0, 1e-9]])
