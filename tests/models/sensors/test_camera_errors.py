"""Errors of a camera that stay, against Intel's formula, data sheets, and what they stay with."""

import numpy as np
import pytest
from scipy.ndimage import label

from feasigrasp.models.geometry import se3
from feasigrasp.models.sensors import MATERIALS, CameraErrors, DepthNoise

SIZE = 240, 424
K = (223.4, 216.5, 211.5, 119.5)  # 87 x 58 degrees
#: Intel's depth quality tool looks at the middle of the image: 20 % of its sides.
MIDDLE = np.s_[96:144, 169:254]
D405 = DepthNoise(baseline=0.018, depth_step=0.0)
D435 = DepthNoise(depth_step=0.0)
EVERYWHERE = np.ones(SIZE, dtype=bool)


def images(noise, z, count=1, seed=0, material="matt", X_OC=None):
    """Images of a wall at right angles to the line of sight."""
    camera, depth = CameraErrors(noise, seed, SIZE), np.full(SIZE, z)
    X = se3.make_pose(np.eye(3), [0.0, 0.0, -z]) if X_OC is None else X_OC
    fixed = camera.fixed(depth, K, (X, X), EVERYWHERE, MATERIALS[material])
    rngs = map(np.random.default_rng, range(count))
    return np.array([noise.apply(depth, K, rng, fixed=fixed) for rng in rngs])


def plane_fit_rms(image):
    """What is left of an image after a least-squares plane, in depth."""
    z = image[MIDDLE]
    v, u = np.indices(z.shape)
    rows = np.column_stack([u.ravel(), v.ravel(), np.ones(z.size)])
    return np.std(z.ravel() - rows @ np.linalg.lstsq(rows, z.ravel(), rcond=None)[0])


@pytest.mark.parametrize("noise", [D405, D435])
@pytest.mark.parametrize("z", [0.15, 0.3, 0.5, 1.0])
def test_plane_fit_rms_is_intels_formula(noise, z):
    """z^2 s / (f B) with s = 0.08 px, and the matcher's steps of 1/32 px."""
    unit = z**2 / (K[0] * noise.baseline)
    expected = unit * np.hypot(0.08, 1.0 / 32.0 / np.sqrt(12.0))
    found = np.sqrt(np.mean([plane_fit_rms(images(noise, z, seed=k)[0]) ** 2 for k in range(6)]))
    assert found == pytest.approx(expected, rel=0.12)


@pytest.fixture(scope="module")
def sixty():
    return [CameraErrors(DepthNoise(), seed, (2, 2)) for seed in range(60)]


@pytest.mark.parametrize(
    ("baseline", "z", "accuracy"), [(0.05, 2.0, 0.02), (0.018, 0.2, 0.014), (0.018, 0.5, 0.02)]
)
def test_cameras_are_within_the_accuracy_of_their_data_sheets(sixty, baseline, z, accuracy):
    """D435, D405 of 2022 and of 2026; and no camera is perfect."""
    disparity = K[0] * baseline / z
    errors = [c.scale * disparity / (disparity + c.bias) - 1.0 for c in sixty]
    assert np.mean(np.abs(errors) < accuracy) >= 0.9
    assert np.std(errors) > 0.2 * accuracy


def test_averages_are_nearly_as_wavy_as_one_image():
    """50 independent ones would have a seventh; of these three quarters of the variance stay."""
    found = images(D405, 0.3, 50)
    one, mean = plane_fit_rms(found[0]), plane_fit_rms(found.mean(axis=0))
    assert mean / one == pytest.approx(np.sqrt(0.75), abs=0.06)


def errors_at(p_OC, turn, camera):
    """Of 9 x 9 pixels about a point of the object, seen 0.3 m away at an angle [deg]."""
    R = se3.so3_exp(np.deg2rad([turn, 0.0, 0.0]))
    X_OC = se3.make_pose(R, np.asarray(p_OC) - 0.3 * R[:, 2])
    depth, mask = np.full((9, 9), 0.3), np.ones((9, 9), dtype=bool)
    k = (223.4, 223.4, 4.0, 4.0)
    return camera.fixed(depth, k, (np.eye(4), X_OC), mask, MATERIALS["matt"]).disparity[4, 4]


@pytest.mark.parametrize(
    ("shift", "turn", "expected"),
    [(0.0, 0.0, 1.0), (0.002, 0.0, 0.94), (0.02, 0.0, 0.0), (0.0, 20.0, 0.94), (0.0, 60.0, 0.5)],
)
def test_half_of_what_stays_goes_with_the_point_and_the_direction(shift, turn, expected):
    """exp(-s^2 / 4 l^2) over a shift s along the surface, cos a over an angle a."""
    camera = CameraErrors(DepthNoise(fixed=1.0), 1, (9, 9))
    places = np.random.default_rng(2).uniform(-0.1, 0.1, (600, 3))
    one = np.array([errors_at(p, 0.0, camera) for p in places])
    other = np.array([errors_at(p + [shift, 0.0, 0.0], turn, camera) for p in places])
    assert np.corrcoef(one, other)[0, 1] == pytest.approx(expected, abs=0.12)
    assert np.std(one) == pytest.approx(np.sqrt(0.5), rel=0.12)  # the pixel's half is constant


def test_the_world_does_not_move_the_objects_errors():
    camera, depth = CameraErrors(DepthNoise(), 0, SIZE), np.full(SIZE, 0.3)
    far = se3.make_pose(np.eye(3), [0.7, -0.2, 0.1])
    seen = (camera.fixed(depth, K, (X, np.eye(4)), EVERYWHERE, MATERIALS["shiny"])
            for X in (np.eye(4), far))  # fmt: skip
    one, other = seen
    np.testing.assert_array_equal(one.disparity, other.disparity)
    np.testing.assert_array_equal(one.holes, other.holes)
    world = camera.fixed(depth, K, (far, np.eye(4)), ~EVERYWHERE, MATERIALS["shiny"])
    assert abs(np.corrcoef(one.disparity.ravel(), world.disparity.ravel())[0, 1] - 0.5) < 0.1
    assert not world.holes.any()


@pytest.mark.parametrize("material", MATERIALS)
def test_materials_lose_their_share_in_patches(material):
    found = np.array([images(D405, 0.4, seed=k, material=material)[0] == 0.0 for k in range(6)])
    share = MATERIALS[material].holes
    assert found.mean() == pytest.approx(share, abs=0.05)
    if share:
        patches = label(found[0])[1]
        assert found[0].sum() / patches > 8  # pixels each


def test_holes_stay_and_all_sizes_scale():
    lost = images(D405, 0.3, 3, material="shiny") == 0.0
    assert (lost == lost[0]).all()
    twice = D405.scaled(2.0)
    assert (twice.subpixel, twice.scale_error, twice.bias, twice.holes) == (0.16, 0.01, 0.1, 2.0)
    assert (twice.baseline, twice.edge_missing) == (D405.baseline, D405.edge_missing)
    rms = [plane_fit_rms(images(noise, 0.3)[0]) for noise in (D405, twice)]
    assert rms[1] / rms[0] == pytest.approx(2.0, abs=0.1)
    assert (images(twice, 0.3, material="shiny") == 0.0).mean() == pytest.approx(0.4, abs=0.06)
