"""The map of seen space, of a made-up wall that is seen from one side."""

import numpy as np
import pytest

from feasigrasp.models.clouds.observed_space import (
    BEHIND,
    BESIDE,
    SCENE_VOXEL,
    DepthView,
    ObservedSpace,
)

WIDTH, HEIGHT, FOCAL = 160, 120, 110.0
LOW, SIZE = np.array([-0.8, -0.8, -0.2]), np.array([1.6, 1.6, 1.4])
#: The wall stands at y = 0.3, |x| < 0.4, below z = 0.6; its back is 4 cm behind. Far behind it,
#: at y = 1.5, is the wall of the room.
TOP, HALF, FRONT, BACK, ROOM = 0.6, 0.4, 0.3, 0.34, 1.5


def camera(p_WC, target):
    """Pose of a camera at ``p_WC`` that looks at ``target``, its x axis level."""
    z = np.subtract(target, p_WC) / np.linalg.norm(np.subtract(target, p_WC))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    X_WC = np.eye(4)
    X_WC[:3, :3], X_WC[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), p_WC
    return X_WC


def hit(origin, rays, low, high):
    """How far along rays (n, 3) from one point a box is; infinity where it is missed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = (np.subtract(corner, origin) / rays for corner in (low, high))
    first = np.nanmax(np.minimum(near, far), axis=1)
    last = np.nanmin(np.maximum(near, far), axis=1)
    return np.where((first <= last) & (first > 0.0), first, np.inf)


WALL = ([-HALF, FRONT, -0.2], [HALF, BACK, TOP])
BACKGROUND = ([-9.0, ROOM, -9.0], [9.0, ROOM + 0.1, 9.0])


def view(X_WC, *boxes):
    """The pixel-ordered cloud (3, h, w) of some boxes."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays_C = np.stack(
        [(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones(u.shape)], axis=-1
    )
    rays = rays_C.reshape(-1, 3) @ X_WC[:3, :3].T
    depth = np.min([hit(X_WC[:3, 3], rays, *box) for box in boxes], axis=0)
    with np.errstate(invalid="ignore"):
        cloud = X_WC[:3, 3] + depth[:, None] * rays
    cloud[~np.isfinite(depth)] = np.inf
    return cloud.T.reshape(3, HEIGHT, WIDTH)


def looked(space, X_WC, *boxes):
    """The space after one more view, and the points and directions that it adds."""
    cloud = view(X_WC, *boxes)
    points = cloud[:, np.isfinite(cloud).all(axis=0)].T
    towards = X_WC[:3, 3] - points
    directions = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    return space.seen(DepthView.of_cloud(cloud, X_WC), points), points, directions


LEVEL = camera([0.0, -0.5, 0.3], [0.0, FRONT, 0.05])  # does not see the upper edge
ABOVE = camera([0.0, -0.4, 1.0], [0.0, FRONT, 0.6])
NOTHING = ObservedSpace.unknown(LOW, SIZE)


def is_free(space, x):
    return space.free[*np.rint((np.asarray(x) - space.low) / SCENE_VOXEL).astype(int)]


def hides(hidden, x):
    """Whether a point lies in one of the hidden voxels."""
    return np.abs(hidden - x).max(axis=1).min(initial=np.inf) <= 0.5 * SCENE_VOXEL + 1e-9


def test_the_camera_is_found_in_its_cloud():
    cloud = view(LEVEL, WALL, BACKGROUND)
    cloud[:, 10:30, 20:70] = np.inf
    seen = DepthView.of_cloud(cloud, LEVEL)
    np.testing.assert_allclose(seen.pinhole, (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), rtol=1e-9)
    assert (seen.depth[10:30, 20:70] == 0.0).all()


@pytest.mark.parametrize("few", [0, 5])
def test_a_cloud_that_shows_next_to_nothing_is_no_view(few):
    cloud = np.full((3, HEIGHT, WIDTH), np.inf)
    cloud[:, :few, :few] = view(LEVEL, WALL)[:, 60 : 60 + few, 60 : 60 + few]
    assert DepthView.of_cloud(cloud, LEVEL) is None


def test_free_is_exactly_what_lies_before_the_wall():
    """No voxel is free that any part of the wall is in, and half a metre before it most are."""
    space, _, _ = looked(NOTHING, LEVEL, WALL, BACKGROUND)
    at = space.low + SCENE_VOXEL * np.argwhere(space.free)
    inside = (at > np.array(WALL[0]) - 0.0125) & (at < np.array(WALL[1]) + 0.0125)
    assert not inside.all(axis=1).any()
    behind = (at[:, 1] > BACK) & (np.abs(at[:, 0]) < HALF) & (at[:, 2] < TOP)
    assert not behind.any()
    for x in ([0.0, 0.2, 0.2], [0.1, 0.0, 0.3], [0.2, 0.1, 0.1]):
        assert is_free(space, x)
    assert not is_free(space, [0.0, -0.6, 0.3])  # behind the camera


def test_hidden_back_and_upper_edge_are_kept_clear_of_and_the_free_air_is_not():
    space, points, directions = looked(NOTHING, LEVEL, WALL)
    rim = points[np.abs(points[:, 0]) < 0.05, 2].max()  # how high the wall was seen
    assert 0.4 < rim < TOP - 0.1
    hidden = space.hidden(points, directions)
    for height in np.arange(0.1, rim, 0.05):
        assert hides(hidden, [0.0, FRONT + 0.05, height])  # the back
    for height in np.arange(rim + 0.025, min(TOP, rim + BESIDE), 0.025):
        assert hides(hidden, [0.0, FRONT + 0.01, height])  # the edge that the picture cuts off
    for x in ([0.0, 0.2, 0.2], [0.0, 0.25, 0.5], [0.0, FRONT - 0.05, rim + 0.1], [0.0, 0.7, 0.2]):
        assert not hides(hidden, x)
    # Nothing in front of the wall, nor farther than what may belong to it.
    assert (hidden[:, 1] > FRONT - SCENE_VOXEL).all()
    assert (hidden[:, 1] < FRONT + BEHIND + SCENE_VOXEL).all()


def test_a_second_view_from_above_frees_what_is_beyond_the_edge():
    space, points, directions = looked(NOTHING, LEVEL, WALL, BACKGROUND)
    wall = points[:, 1] < BACK
    over = np.array([0.0, FRONT + 0.01, TOP + 0.06])
    assert hides(space.hidden(points[wall], directions[wall]), over)
    space, more, towards = looked(space, ABOVE, WALL, BACKGROUND)
    wall_2 = more[:, 1] < BACK + 0.01
    hidden = space.hidden(
        np.concatenate([points[wall], more[wall_2]]),
        np.concatenate([directions[wall], towards[wall_2]]),
    )
    assert not hides(hidden, over)
    assert hides(hidden, [0.0, FRONT + 0.05, 0.2])  # behind it nobody has looked


def test_the_order_of_the_cameras_does_not_matter():
    aside = camera([-0.6, -0.5, 0.5], [0.1, FRONT, 0.3])
    spaces = []
    for order in ((LEVEL, ABOVE, aside), (aside, LEVEL, ABOVE)):
        space = NOTHING
        for X_WC in order:
            space, _, _ = looked(space, X_WC, WALL, BACKGROUND)
        spaces.append(space.free)
    np.testing.assert_array_equal(*spaces)
    assert spaces[0].any()


def test_where_the_arm_is_nothing_is_hidden():
    space, points, directions = looked(NOTHING, LEVEL, WALL)
    center = np.array([[0.0, FRONT + 0.05, 0.55], [5.0, 0.0, 0.0]])
    assert hides(space.hidden(points, directions), center[0])
    hidden = space.occupied_by(center, np.array([0.1, 0.1])).hidden(points, directions)
    assert np.linalg.norm(hidden - center[0], axis=1).min() > 0.1
    assert hides(hidden, [0.3, FRONT + 0.05, 0.2])


def test_behind_what_has_come_nothing_is_known_any_more():
    box = ([-0.1, 0.0, 0.1], [0.1, 0.1, 0.4])
    before, _, _ = looked(NOTHING, LEVEL, WALL, BACKGROUND)
    after, points, directions = looked(before, LEVEL, box, WALL, BACKGROUND)
    inside = [0.0, 0.05, 0.25]
    assert is_free(before, inside) and not is_free(after, inside)
    on_box = np.abs(points[:, 1]) < 0.01
    assert hides(after.hidden(points[on_box], directions[on_box]), inside)
    gone, _, _ = looked(after, LEVEL, WALL, BACKGROUND)
    assert is_free(gone, inside)


def test_what_the_camera_looks_through_has_gone():
    box = ([-0.1, 0.0, 0.1], [0.1, 0.1, 0.4])
    _, points, _ = looked(NOTHING, LEVEL, box, WALL)
    through = DepthView.of_cloud(view(LEVEL, WALL), LEVEL).looks_through(points)
    on_box = points[:, 1] < 0.2
    assert through[on_box].mean() > 0.95 and not through[~on_box].any()
    behind_the_camera = np.array([[0.0, -1.0, 0.3]])
    assert not DepthView.of_cloud(view(LEVEL, WALL), LEVEL).looks_through(behind_the_camera).any()
