"""What a view leaves open, pixel by pixel."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.clouds.edges import outline

CAMERA = Camera((50.0, 60.0, 30.0, 20.0), 64, 48, 0.1, 0.0)
#: Where the part of the image is that the masks are of.
CORNER = (4, 7)


def mask(rows, columns, shape=(30, 40)):
    pixels = np.zeros(shape, dtype=bool)
    pixels[slice(*rows), slice(*columns)] = True
    return pixels


BODY, NOTHING = mask((5, 25), (5, 35)), mask((0, 0), (0, 0))


def pixels_of(rays):
    """The mask whose pixels' lines of sight these are."""
    u, v = CAMERA.pixels(3.0 * rays)  # of any length
    pixels = np.zeros(BODY.shape, dtype=bool)
    pixels[np.rint(v).astype(int) - CORNER[0], np.rint(u).astype(int) - CORNER[1]] = True
    return pixels


def test_a_part_without_depth_is_told_but_not_the_pixels_at_an_edge():
    kept = mask((6, 24), (6, 34)) & ~mask((10, 20), (10, 20))
    found = outline(kept, BODY, NOTHING, CORNER, CAMERA)
    np.testing.assert_array_equal(pixels_of(found.unmeasured), mask((11, 19), (11, 19)))
    assert len(found.unmeasured) == 64 and len(found.hidden) == 0 and found.whole


def test_what_is_before_the_body_is_told():
    finger = mask((0, 12), (8, 14))
    found = outline(BODY & ~finger, BODY & ~finger, finger, CORNER, CAMERA)
    np.testing.assert_array_equal(pixels_of(found.hidden), finger)


@pytest.mark.parametrize(
    ("rows", "columns", "whole"),
    [((5, 25), (5, 35), True), ((0, 25), (5, 35), False), ((5, 25), (39, 40), False)],
)
def test_a_silhouette_at_the_border_of_the_picture_is_not_whole(rows, columns, whole):
    body = mask(rows, columns)
    assert outline(body, body, NOTHING, CORNER, CAMERA).whole is whole


def test_of_nothing_there_is_none():
    empty = np.zeros((0, 0), dtype=bool)
    found = outline(empty, empty, empty, (0, 0), CAMERA)
    assert len(found.unmeasured) == len(found.hidden) == 0 and found.whole


def test_it_turns_with_its_axes():
    R = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    found = outline(NOTHING, BODY, mask((0, 3), (0, 3)), CORNER, CAMERA)
    back = found.turned(R).turned(R.T)
    np.testing.assert_allclose(back.unmeasured, found.unmeasured, atol=1e-12)
    np.testing.assert_allclose(found.turned(R).hidden[0], R @ found.hidden[0], atol=1e-12)
