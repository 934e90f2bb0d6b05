"""A scanty mask is grown along the surface that it is on, and nowhere else."""

import numpy as np

from feasigrasp.models.clouds.edges import EDGE_JUMP, GROWTH, SCANTY, grown_mask

ROWS, COLUMNS = np.mgrid[0:60, 0:80]
#: A disc of radius 12 pixels before a wall, both in front of the camera.
DISC = np.hypot(ROWS - 30, COLUMNS - 40) <= 12.0
FREE = np.ones(DISC.shape, dtype=bool)


def points(depth):
    return np.stack([COLUMNS * depth / 200.0, ROWS * depth / 200.0, depth])


SCENE = points(np.where(DISC, 0.4, 0.9))


def within(radius):
    return np.hypot(ROWS - 30, COLUMNS - 40) <= radius


def test_an_eroded_mask_gets_its_surface_back():
    grown = grown_mask(SCENE, within(4.0), FREE, EDGE_JUMP)
    assert not np.any(grown & ~DISC)
    assert np.all(grown[within(10.0)])  # what is nearer to the rim is an edge


def test_it_grows_no_farther_than_it_is_let():
    wall = points(np.full(DISC.shape, 0.5))
    grown = grown_mask(wall, within(3.0), FREE, EDGE_JUMP)
    rows, columns = np.nonzero(grown)
    far = np.abs(rows - 30) + np.abs(columns - 40)
    assert 3 + GROWTH <= far.max() <= 5 + GROWTH


def test_what_is_known_to_be_something_else_stays_out():
    left = COLUMNS < 38
    grown = grown_mask(SCENE, within(1.5), FREE & ~left, EDGE_JUMP)
    assert not np.any(grown & left & ~within(1.5))
    assert np.count_nonzero(grown) > 100


def test_a_mask_that_shows_enough_and_an_empty_one_stay():
    enough = within(8.0)
    assert np.count_nonzero(enough) >= SCANTY
    for mask in (enough, np.zeros_like(enough)):
        np.testing.assert_array_equal(grown_mask(SCENE, mask, FREE, EDGE_JUMP), mask)


def test_pixels_without_a_point_stop_it():
    lost = SCENE.copy()
    lost[:, :, 42:46] = np.inf
    grown = grown_mask(lost, within(1.5), FREE, EDGE_JUMP)
    assert not np.any(grown[:, 42:])
