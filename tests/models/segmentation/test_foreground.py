"""Balls before a wall: found, told apart, followed, chosen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.segmentation.components import MIN_PIXELS, find_components
from feasigrasp.models.segmentation.foreground import CameraView, Known, Label, segment
from feasigrasp.models.segmentation.modeled_bodies import Boxes, Kind, ModeledBodies
from feasigrasp.models.shape.gpdf import fit_gpdf

WIDTH, HEIGHT, F = 160, 120, 130.0
CAMERA = Camera((F, F, 79.5, 59.5), WIDTH, HEIGHT, 0.1, 0.0)
GRIPPER = ParallelGripper()
Q = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
X_WG = forward_kinematics(Q, GRIPPER.X_FG)
#: The camera looks along the approach direction, far enough behind the hand not to be in it.
X_WC = X_WG.copy()
X_WC[:3, 3] = X_WG @ [0.0, 0.3, 0.0, 1.0] @ np.eye(4)[:, :3]
RADIUS = 0.03


def view(balls, wall=0.8, noise=0.0, seed=0, X_WC=X_WC):
    """A picture of balls (centre in the first camera's frame) before a wall, by ray casting."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    _, _, cx, cy = CAMERA.intrinsics
    rays = np.stack([(u - cx) / F, (v - cy) / F, np.ones_like(u, float)], -1)
    rays = rays.reshape(-1, 3)
    depth = np.full(len(rays), wall)
    shows = np.zeros(len(rays), dtype=int)
    for number, centre in enumerate(balls, start=1):
        b = rays @ centre
        a, c = np.square(rays).sum(axis=1), np.dot(centre, centre) - RADIUS**2
        root = b**2 - a * c
        z = np.where(root > 0.0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
        shows[z < depth] = number
        depth = np.minimum(depth, z)
    depth = depth + noise * depth**2 * np.random.default_rng(seed).standard_normal(len(depth))
    points = (rays * depth[:, None]) @ X_WC[:3, :3].T + X_WC[:3, 3]
    return CameraView(points.astype(np.float32), X_WC), shows.reshape(HEIGHT, WIDTH)


def wall_box(wall=0.8, thickness=0.1):
    X_WB = X_WC.copy()
    X_WB[:3, 3] += (wall + thickness / 2) * X_WC[:3, 2]
    return Boxes(X_WB[None], np.array([[2.0, 2.0, thickness / 2]]))


BODIES = ModeledBodies(GRIPPER, wall_box())


def labels(balls, camera=CAMERA, known=None, bodies=BODIES, **options):
    image, shows = view(balls, noise=camera.depth_noise, **options)
    return segmented(image, known or Known(), bodies, camera), shows


def segmented(image, known, bodies, camera):
    kinds = bodies.kinds(image.points, image.X_WC, Q, 0.085, camera.depth_noise)
    return segment(image, known, kinds, bodies.hand(Q), camera)


def test_a_ball_before_a_known_wall_is_the_object_and_nothing_else():
    found, shows = labels([[0.0, 0.0, 0.45]])
    assert np.count_nonzero(shows) > 150
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 1)
    assert (found[shows == 0] == Label.SURROUNDINGS).all()


@pytest.mark.parametrize("noise", [0.007, 0.02])
def test_noise_of_either_camera_leaves_the_mask(noise):
    """As of a D435 and of a D405; with pixels that fly between ball and wall."""
    image, shows = view([[0.0, 0.0, 0.45]], noise=noise)
    rim = (shows == 1) & ~ndimage.binary_erosion(shows == 1)
    fly = rim.ravel() & (np.random.default_rng(1).random(rim.size) < 0.3)
    camera = image.X_WC[:3, 3]
    image.points[fly] = camera + 1.25 * (image.points[fly] - camera)
    found = segmented(image, Known(), BODIES, replace(CAMERA, depth_noise=noise))
    mask, truth = found == Label.OBJECT, (shows == 1) & ~fly.reshape(shows.shape)
    assert np.count_nonzero(mask & truth) > 0.97 * np.count_nonzero(truth)
    assert not mask[shows == 0].any()
    assert (found.ravel()[fly] == Label.UNCLEAR).mean() > 0.5


def test_pixels_without_depth_amid_the_object_are_the_objects():
    image, shows = view([[0.0, 0.0, 0.45]])
    hole = np.ravel_multi_index((60, 80), shows.shape)
    outside = np.ravel_multi_index((5, 5), shows.shape)
    image.points[[hole, outside]] = np.inf
    found = segmented(image, Known(), BODIES, CAMERA).ravel()
    assert (found[hole], found[outside]) == (Label.OBJECT, Label.SURROUNDINGS)


def test_of_several_balls_that_nearest_to_the_hand_is_taken():
    near, far = [-0.10, 0.0, 0.50], [0.10, -0.05, 0.62]
    for order in ([near, far], [far, near]):
        found, shows = labels(order)
        np.testing.assert_array_equal(found == Label.OBJECT, shows == order.index(near) + 1)
        assert (found[shows == order.index(far) + 1] == Label.UNCLEAR).all()


def test_of_several_balls_that_which_moves_is_taken():
    near, far, moved = [-0.10, 0.0, 0.50], [0.10, -0.05, 0.62], [0.085, -0.05, 0.62]
    before, _ = view([near, far])
    found, shows = labels([near, moved], known=Known(before=before))
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 2)
    still, shows = labels([near, far], known=Known(before=before))
    np.testing.assert_array_equal(still == Label.OBJECT, shows == 1)


def test_of_several_balls_that_move_that_nearest_to_the_hand_is_taken():
    balls = [[-0.10, 0.0, 0.50], [0.10, -0.05, 0.62], [0.0, 0.1, 0.48]]
    before, _ = view(balls)
    # The second has moved farther than the first; the third, nearest of all, rests.
    moved = [[-0.085, 0.0, 0.50], [0.08, -0.05, 0.62], balls[2]]
    found, shows = labels(moved, known=Known(before=before))
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 1)


def test_which_of_several_balls_moves_is_waited_for_a_while():
    balls = [[-0.10, 0.0, 0.50], [0.10, -0.05, 0.62]]
    before, _ = view(balls)
    found, shows = labels(balls, known=Known(before=before, waited=0.5))
    assert (found[shows > 0] == Label.UNCLEAR).all()
    found, shows = labels(balls, known=Known(before=before, waited=1.5))
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 1)
    # Of one there is nothing to wait for.
    found, shows = labels(balls[1:], known=Known(before=before, waited=0.0))
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 1)


def test_what_is_known_to_carry_a_ball_is_not_of_it():
    image, shows = view([[0.0, 0.0, 0.45], [0.0, 0.05, 0.46]])  # they touch
    kinds = BODIES.kinds(image.points, image.X_WC, Q, 0.085, 0.0)
    both = segment(image, Known(), kinds, BODIES.hand(Q), CAMERA)
    np.testing.assert_array_equal(both == Label.OBJECT, shows > 0)
    kinds[(shows == 2).ravel()] = Kind.CARRIER
    found = segment(image, Known(), kinds, BODIES.hand(Q), CAMERA)
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 1)
    np.testing.assert_array_equal(found == Label.CARRIER, shows == 2)


def test_a_click_or_a_box_decides():
    balls = [[-0.10, 0.0, 0.50], [0.10, -0.05, 0.62]]
    _, shows = view(balls)
    row, column = np.argwhere(shows == 2).mean(axis=0)
    for box in ([column, row, column, row], [column - 20, row - 20, column + 20, row + 20]):
        found, _ = labels(balls, known=Known(box=np.array(box)))
        np.testing.assert_array_equal(found == Label.OBJECT, shows == 2)
    for box in ([0, 0, 0, 0], [0, -50, 319, -5], [-9, 0, -3, 239]):
        nothing = Known(box=np.array(box, float))
        assert not (labels(balls, known=nothing)[0] == Label.OBJECT).any()


def field_of_a_ball():
    """The field of a ball in a frame O at its centre, seen all round."""
    i = np.arange(300) + 0.5
    polar, azimuth = np.arccos(1 - i / 150), np.pi * (1 + 5**0.5) * i
    s = np.sin(polar)
    points = RADIUS * np.stack([np.cos(azimuth) * s, np.sin(azimuth) * s, np.cos(polar)], 1)
    return fit_gpdf(points, viewpoint=2.0 * points)


def pose_at(p_C):
    X_WO = np.eye(4)
    X_WO[:3, 3] = X_WC[:3, :3] @ p_C + X_WC[:3, 3]
    return X_WO


def test_with_a_field_the_object_is_followed_whatever_else_there_is():
    other, ball = [-0.10, 0.0, 0.50], [0.10, -0.05, 0.62]
    expected = [0.095, -0.05, 0.62]  # 5 mm off
    known = Known(field_of_a_ball(), pose_at(expected))
    found, shows = labels([other, ball], known=known)
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 2)
    assert (found[shows == 1] == Label.SURROUNDINGS).all()
    # Out of sight: nothing is taken for it, until it is lost; then what is nearest to where it was.
    gone, shows = labels([other], known=known)
    assert not (gone == Label.OBJECT).any()
    lost = known._replace(lost=True)
    np.testing.assert_array_equal(labels([other], known=lost)[0] == Label.OBJECT, shows == 1)
    shifted = [other, [0.10, 0.05, 0.62]]
    found, shows = labels(shifted, known=lost)
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 2)


@pytest.mark.parametrize("wall", [0.8, 0.52])
def test_a_wall_of_no_model_is_seen_to_be_too_large(wall):
    """At once, in the first image, although the ball stands 3 cm before it or shows far less."""
    found, shows = labels([[0.05, 0.0, 0.45]], bodies=ModeledBodies(GRIPPER), wall=wall)
    np.testing.assert_array_equal(found == Label.OBJECT, shows == 1)
    on_wall = found[(shows == 0) & (found != Label.UNCLEAR)]  # the rest is out of reach, or an edge
    assert (on_wall == Label.SURROUNDINGS).all()
    assert len(on_wall) > 0.7 * np.count_nonzero(shows == 0)


def test_what_touches_a_larger_body_is_found_pixel_by_pixel():
    """The ball rests against a wall that nobody knows of."""
    ball = [0.0, 0.0, 0.50]
    known = Known(field_of_a_ball(), pose_at(ball))
    found, shows = labels([ball], known=known, bodies=ModeledBodies(GRIPPER), wall=0.505)
    mask, truth = found == Label.OBJECT, shows == 1
    assert np.count_nonzero(mask & truth) > 0.9 * np.count_nonzero(truth)
    image, _ = view([ball], wall=0.505)
    from_centre = np.linalg.norm(image.points - pose_at(ball)[:3, 3], axis=1)
    assert from_centre[mask.ravel()].max() < RADIUS + 0.008


def test_small_components_are_none_and_near_ones_are_one_body():
    """Of pixel-sized pieces, against SciPy's labels."""
    rng = np.random.default_rng(0)
    chosen = ndimage.gaussian_filter(rng.standard_normal((HEIGHT, WIDTH)), 2.0) > 0.05
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    points = np.stack([0.001 * u, 0.001 * v, np.zeros_like(u)], -1).reshape(-1, 3)
    found = find_components(points.astype(np.float32), chosen.ravel(), np.zeros(3), CAMERA)
    expected, count = ndimage.label(chosen)
    sizes = ndimage.sum_labels(chosen, expected, np.arange(1, count + 1))
    assert sorted(found.pixels) == sorted(sizes[sizes >= MIN_PIXELS])
    number = found.number.reshape(HEIGHT, WIDTH)
    for k in range(len(found.pixels)):
        assert len(np.unique(expected[number == k])) == 1
    assert sum(map(len, found.groups())) == len(found.pixels)
    assert len(found.groups()) == 1  # a millimetre apart
