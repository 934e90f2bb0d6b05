"""Points of a depth image, and the pixels of points."""

import numpy as np

from feasigrasp.models.clouds.camera import project, unproject

INTRINSICS = 310.0, 305.0, 41.5, 28.0


def test_points_of_an_image_are_seen_where_they_came_from():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.1, 2.0, (60, 80))
    points = unproject(depth, INTRINSICS)
    np.testing.assert_array_equal(points[2], depth)
    u, v = project(points.reshape(3, -1).T, INTRINSICS)
    rows, columns = np.indices(depth.shape)
    np.testing.assert_allclose(u, columns.ravel(), atol=1e-9)
    np.testing.assert_allclose(v, rows.ravel(), atol=1e-9)


def test_what_has_no_depth_has_no_point():
    points = unproject(np.array([[1.0, np.inf, np.nan]]), (300.0, 300.0, 1.0, 0.0))
    assert np.isfinite(points).all(axis=0).tolist() == [[True, False, False]]
