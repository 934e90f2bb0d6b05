"""The oscillation of a path, against paths known in closed form."""

import numpy as np
import pytest

from feasigrasp.models.objects.pose_filter import PATH_LENGTH, PATH_STEP
from feasigrasp.models.objects.prediction import STILL, oscillation_kernel, shape_kernel

#: Times of the points, the newest first.
T = -PATH_STEP * np.arange(PATH_LENGTH)
#: Times at which what is found is compared.
AROUND = np.linspace(-2.0, 1.0, 31)


def swing(t, omega=5.0, drift=0.0):
    """An oscillation of 12 cm about a middle that drifts; far from the origin."""
    return 1.3 + drift * t + 0.12 * np.sin(omega * t + 0.4)


def found_at(known, path, t):
    """The axis at times t, by what was found."""
    S, C, _ = np.transpose([shape_kernel(known.omega, s) for s in t])
    return path[0] + known.p + known.v * S + known.a * C + known.drift * (t - S)


@pytest.mark.parametrize(("omega", "drift"), [(0.5, 0.0), (2.0, 0.0), (5.0, 0.0), (5.0, 0.01)])
def test_an_oscillation_is_found_as_it_is(omega, drift):
    path = swing(T, omega, drift)
    known = oscillation_kernel(path, PATH_LENGTH)
    expected = swing(AROUND, omega, drift)
    np.testing.assert_allclose(found_at(known, path, AROUND), expected, atol=3e-4)
    np.testing.assert_allclose([known.omega, known.drift], [omega, drift], atol=2e-3)
    assert known.beside < 1e-9


def test_noise_is_averaged_out():
    """1.5 mm at every point: a parabola through the newest three errs by 80 mm/s."""
    errors, later = [], []
    for seed in range(40):
        path = swing(T) + 1.5e-3 * np.random.default_rng(seed).standard_normal(PATH_LENGTH)
        known = oscillation_kernel(path, PATH_LENGTH)
        errors.append(known.v - 0.12 * 5.0 * np.cos(0.4))
        later.append(found_at(known, path, [0.5])[0] - swing(0.5))
    assert np.sqrt(np.mean(np.square(errors))) < 0.012
    assert np.sqrt(np.mean(np.square(later))) < 3e-3


@pytest.mark.parametrize("path", [0.3 * T, 0.3 * T + 0.05 * T**2, np.full(PATH_LENGTH, 0.7)])
def test_what_does_not_swing_is_a_parabola(path):
    known = oscillation_kernel(path, PATH_LENGTH)
    assert known.omega == STILL
    slope, bend = np.polyfit(T, path, 2)[1], 2.0 * np.polyfit(T, path, 2)[0]
    np.testing.assert_allclose([known.v, known.mean], [slope, bend], rtol=1e-3, atol=1e-4)


def test_a_path_that_ends_is_beside_any_oscillation():
    """At rest since 0.3 s: what was found before is no use any more, and it is seen."""
    assert oscillation_kernel(swing(np.minimum(T + 0.3, 0.0)), PATH_LENGTH).beside > 4e-6


def test_a_short_path_says_nothing():
    assert oscillation_kernel(swing(T), 11).beside == np.inf


def test_moving_or_mirroring_the_axis_changes_nothing_else():
    path = swing(T, drift=0.01) + 1e-3 * np.random.default_rng(0).standard_normal(PATH_LENGTH)
    here, there = oscillation_kernel(path, PATH_LENGTH), oscillation_kernel(2.0 - path, PATH_LENGTH)
    mirrored = here._replace(p=-here.p, v=-here.v, a=-here.a, drift=-here.drift, mean=-here.mean)
    np.testing.assert_allclose(there, mirrored, rtol=1e-9, atol=1e-12)
