"""Color of an object against its surroundings."""

import numpy as np

from feasigrasp.models.segmentation.modeled_bodies import ColorHistogram


def test_colors_of_the_object_are_probable_and_unknown_ones_say_nothing():
    rng = np.random.default_rng(0)
    image = np.zeros((60, 80, 3), dtype=np.uint8)
    image[...] = [200, 200, 200]
    of_object = np.zeros((60, 80), dtype=bool)
    of_object[20:40, 20:50] = True
    image[of_object] = [200, 40, 30]
    image[of_object & (rng.random((60, 80)) < 0.3)] = [200, 200, 200]  # shared by both
    learnt = ColorHistogram.learnt(image, of_object, ~of_object)
    colors = [[[201, 41, 31], [199, 201, 200], [0, 0, 250]]]
    red, gray, blue = learnt.of(np.array(colors, dtype=np.uint8))[0]
    # As frequent on the object as 0.3 to 1 on the rest: Bayes with equal priors.
    assert red > 0.95 and abs(blue - 0.5) < 1e-9
    np.testing.assert_allclose(gray, 0.3 / 1.3, atol=0.03)
