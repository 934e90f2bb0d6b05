"""Hues, against the standard library's conversion of colours."""

import colorsys

import numpy as np
import pytest

from feasigrasp.models.segmentation.modeled_bodies import in_color_gate


def image(*colors):
    """One row of pixels, opaque."""
    rgba = [[*np.rint(255.0 * np.array(color)), 255] for color in colors]
    return np.array([rgba], dtype=np.uint8)


@pytest.mark.parametrize("hue", [0.0, 60.0, 180.0, 315.0, 350.0])
def test_vivid_pixels_near_a_hue_are_of_it_and_others_are_not(hue):
    for off in (-60.0, -25.0, -12.0, 0.0, 12.0, 25.0, 60.0, 180.0):
        color = colorsys.hsv_to_rgb((hue + off) / 360.0 % 1.0, 0.9, 0.8)
        assert in_color_gate(image(color), hue) == (abs(off) < 20.0), off


def test_shade_changes_nothing_and_what_is_grey_has_no_hue():
    shades = [colorsys.hsv_to_rgb(0.875, 0.9, value) for value in (1.0, 0.5, 0.2)]
    assert in_color_gate(image(*shades), 315.0).all()
    greys = [(0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (1.0, 1.0, 1.0), (0.55, 0.5, 0.54)]
    assert not in_color_gate(image(*greys), 315.0).any()


def test_it_agrees_with_the_standard_library_pixel_by_pixel():
    rng = np.random.default_rng(0)
    color = rng.integers(0, 256, (20, 30, 4), dtype=np.uint8)
    hsv = np.array([colorsys.rgb_to_hsv(*c[:3] / 255.0) for c in color.reshape(-1, 4)])
    off = np.abs((360.0 * hsv[:, 0] - 100.0 + 180.0) % 360.0 - 180.0)
    clear = (np.abs(off - 20.0) > 1.2) & (np.abs(hsv[:, 1] - 0.35) > 0.01) & (hsv[:, 2] > 0.1)
    expected = (off < 20.0) & (hsv[:, 1] > 0.35)
    assert np.count_nonzero(expected) > 20
    np.testing.assert_array_equal(in_color_gate(color, 100.0)[clear], expected[clear])
