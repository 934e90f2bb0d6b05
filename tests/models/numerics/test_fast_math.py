"""Sines and cosines against the C library, over all quadrants."""

import numpy as np
import pytest
from numba import njit

from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_sincos


@compiled
def sincos_kernel(x, sine, cosine):
    for i in range(len(x)):
        sine[i], cosine[i] = fast_sincos(x[i])


def sincos(x):
    x = np.asarray(x, dtype=float)
    sine, cosine = np.empty_like(x), np.empty_like(x)
    sincos_kernel(x, sine, cosine)
    return sine, cosine


@pytest.mark.parametrize("size", [np.pi, 100.0, 1e6])
def test_equal_to_the_library(size):
    x = np.random.default_rng(0).uniform(-size, size, 100_000)
    sine, cosine = sincos(x)
    np.testing.assert_allclose(sine, np.sin(x), rtol=0, atol=4e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0, atol=4e-16)


def test_around_the_ends_of_the_quadrants():
    x = (np.arange(-40, 41)[:, None] * np.pi / 4 + [-1e-9, -1e-16, 0, 1e-16, 1e-9]).ravel()
    sine, cosine = sincos(x)
    np.testing.assert_allclose(sine, np.sin(x), rtol=0, atol=4e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0, atol=4e-16)
    np.testing.assert_allclose(sine**2 + cosine**2, 1.0, rtol=0, atol=1e-15)


def test_small_angles_keep_their_digits():
    x = np.logspace(-300, -1, 300)
    np.testing.assert_allclose(sincos(x)[0], np.sin(x), rtol=4e-16)


def test_nan_and_infinity():
    assert np.isnan(sincos([np.nan, np.inf, -np.inf])).all()


def test_a_caller_with_fastmath_does_not_spoil_it():
    @njit(fastmath=True)
    def loose(x, out):
        for i in range(len(x)):
            s, c = fast_sincos(x[i])
            out[i] = s + 2.0 * c

    x = np.linspace(-1e5, 1e5, 10_001)
    out = np.empty_like(x)
    loose(x, out)
    np.testing.assert_allclose(out, np.sin(x) + 2 * np.cos(x), rtol=0, atol=2e-15)
