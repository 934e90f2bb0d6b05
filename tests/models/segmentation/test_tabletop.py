"""An object is cut out of a table: made ones, and real captures against their masks."""

import numpy as np
import pytest

from feasigrasp.errors import PointCloudError
from feasigrasp.models.segmentation.tabletop import support_plane, tabletop


def table(rng, n=8000):
    """A table before the camera, leaning by 50 degrees, with a millimetre of noise."""
    lean = np.deg2rad(50.0)
    normal = np.array([0.0, -np.sin(lean), -np.cos(lean)])
    x, y = rng.uniform(-0.3, 0.3, (2, n))
    along = np.array([0.0, np.cos(lean), -np.sin(lean)])
    points = np.outer(x, [1.0, 0.0, 0.0]) + np.outer(y, along) + [0.0, 0.0, 0.6]
    return points + 1e-3 * rng.standard_normal((n, 1)) * normal, normal


def test_the_largest_body_above_the_table_is_kept():
    rng = np.random.default_rng(0)
    points, normal = table(rng)
    ball = rng.standard_normal((2000, 3))
    ball *= 0.04 / np.linalg.norm(ball, axis=1, keepdims=True)
    ball = ball + [0.0, 0.0, 0.6] + 0.042 * normal
    small = 0.2 * (ball[:300] - ball.mean(axis=0)) + [0.15, 0.0, 0.6] + 0.02 * normal
    below = points[:500] - 0.1 * normal  # a floor behind
    found, _ = tabletop(np.concatenate([points, small, ball, below]))
    truth = np.zeros(len(found), dtype=bool)
    truth[8300:10300] = True
    assert not (found & ~truth).any()
    height = (ball - [0.0, 0.0, 0.6]) @ normal
    np.testing.assert_array_equal(found[truth][height > 0.009], True)


def test_an_empty_table_is_refused():
    points, _ = table(np.random.default_rng(0))
    with pytest.raises(PointCloudError, match="nothing of a graspable size stands"):
        tabletop(points)


@pytest.mark.parametrize("name", ["blue_mug", "cheezit", "cylinder", "mustard", "white_bowl"])
def test_real_captures_are_segmented_without_their_masks(shared_data, name):
    data = np.load(shared_data / "real_clouds" / f"6dofgraspnet_{name}.npz")
    z, K = data["depth_0p1mm"] / 1e4, data["K"]
    truth = np.unpackbits(data["object_mask"])[: z.size].astype(bool)[np.flatnonzero(z)]
    v, u = np.nonzero(z)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=1)
    found, _ = tabletop(rays * z[v, u][:, None])
    assert np.count_nonzero(found & truth) / np.count_nonzero(found | truth) > 0.95


def test_the_support_is_under_the_body_and_none_of_its_faces():
    """A block on a table beside another one: the table, though faces of blocks are larger."""
    rng = np.random.default_rng(0)
    p_WC = np.array([0.0, -0.5, 0.5])
    table = np.column_stack([rng.uniform(-0.12, 0.12, (600, 2)), np.zeros(600)])
    table = table[(np.abs(table[:, :2]) > 0.045).any(axis=1)]
    top = np.column_stack([rng.uniform(-0.04, 0.04, (500, 2)), np.full(500, 0.08)])
    front = np.column_stack(
        [rng.uniform(-0.04, 0.04, 500), np.full(500, -0.04), rng.uniform(0.0, 0.08, 500)]
    )
    body = np.concatenate([top, front])
    for around in (table, np.concatenate([table, body])):
        plane = support_plane(around, body, p_WC, 0.005)
        np.testing.assert_allclose(plane, [0.0, 0.0, 1.0, 0.0], atol=1e-3)
    lifted = body + [0.0, 0.0, 0.2]
    assert support_plane(table, lifted, p_WC, 0.005) is None
    # Expected 25 mm too low, as after a sudden step, the table is found by that of the last image.
    low = body - [0.0, 0.0, 0.025]
    assert support_plane(table, low, p_WC, 0.005) is None
    found = support_plane(table, low, p_WC, 0.005, [np.array([0.0, 0.0, 1.0, 0.01])])
    np.testing.assert_allclose(found, [0.0, 0.0, 1.0, 0.0], atol=1e-3)


def test_of_a_box_seen_from_above_the_top_is_found():
    """Its foot is hidden: nothing is seen between its top and the table."""
    rng, height = np.random.default_rng(0), 0.12
    table = rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 0.801], (40000, 3))
    shade = np.abs(table[:, :2]).max(axis=1) < 0.05 * 0.8 / (0.8 - height)
    top = rng.uniform([-0.05, -0.05, 0.8 - height], [0.05, 0.05, 0.8 - height + 1e-3], (2000, 3))
    mask, plane = tabletop(np.concatenate([table[~shade], top]))
    assert mask[-2000:].all() and not mask[:-2000].any()
    np.testing.assert_allclose(plane, [0.0, 0.0, -1.0, 0.8], atol=2e-3)
