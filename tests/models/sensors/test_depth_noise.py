"""The sensor model against its formulas: axial noise, steps, edges, grazing angles."""

import dataclasses

import numpy as np
import pytest

from feasigrasp.errors import CameraError
from feasigrasp.models.clouds.camera import stereo_deviation
from feasigrasp.models.sensors.depth_kernels import cosine_kernel
from feasigrasp.models.sensors.depth_noise import DepthNoise

FX = FY = 384.2
SHAPE = (240, 320)
INTRINSICS = (FX, FY, 159.5, 119.5)
K = np.array([[FX, 0, 159.5], [0, FY, 119.5], [0, 0, 1.0]])


def rng(seed=0):
    return np.random.default_rng(seed)


def plane_depth(normal, distance):
    """Depth image of the plane ``normal . p = distance`` by intersecting every pixel's ray."""
    u, v = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    rays = np.stack([(u - K[0, 2]) / FX, (v - K[1, 2]) / FY, np.ones(SHAPE)], axis=-1)
    with np.errstate(divide="ignore"):
        depth = distance / (rays @ normal)
    return np.where((depth > 0) & (depth < 10), depth, np.inf), rays


@pytest.mark.parametrize(("z", "expected"), [(0.5, 1.04e-3), (1.0, 4.16e-3), (2.0, 16.7e-3)])
def test_axial_noise_grows_with_the_square_of_the_depth(z, expected):
    """z^2 s / (f B) by hand; the steps (1/32 px, 1 mm) add their uniform errors."""
    depth, far = np.full(SHAPE, z), (1e5, 1e5, *INTRINSICS[2:])  # so that no ray is oblique
    baseline = 0.05 * FX / 1e5
    plain = DepthNoise(baseline, disparity_step=0.0, depth_step=0.0, correlation=0.0)
    smooth = plain.apply(depth, far, rng())
    assert np.std(smooth) == pytest.approx(expected, rel=0.02)
    assert z**2 * 0.08 / (FX * 0.05) == pytest.approx(expected, rel=0.005)
    assert z**2 * stereo_deviation(FX) == pytest.approx(expected, rel=0.005)
    # The mean of f B / (disparity + error) is z (1 + (sigma / z)^2) to second order.
    standard_error = expected / np.sqrt(depth.size)
    assert np.mean(smooth) == pytest.approx(z + expected**2 / z, abs=4 * standard_error)
    halved = DepthNoise(0.5 * baseline, 0.08, 0.0, 0.0, correlation=0.0, decimation=2.0)
    np.testing.assert_allclose(halved.apply(depth, far, rng()), smooth, rtol=1e-12)
    stepped = DepthNoise(baseline).apply(depth, far, rng())
    disparity_step = z**2 / (FX * 0.05) / 32
    total = np.sqrt(expected**2 + (disparity_step**2 + 1e-6) / 12)
    assert np.std(stepped) == pytest.approx(total, rel=0.03)


def test_disparities_and_depths_come_in_steps():
    depth = rng().uniform(0.4, 0.8, SHAPE)
    calm = DepthNoise(0.05, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 90.0, 91.0)
    coarse = DepthNoise(subpixel=0.0, disparity_step=0.25, depth_step=0.0, flying=0, edge_missing=0)
    coarse = coarse.apply(depth, INTRINSICS, rng())
    coarse = coarse[np.isfinite(coarse)]  # random depths have grazing slopes
    steps = FX * 0.05 / coarse / 0.25
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert len(np.unique(coarse)) > 50
    millimetres = 1e3 * DepthNoise().apply(np.full(SHAPE, 0.6), INTRINSICS, rng())
    np.testing.assert_allclose(millimetres, np.round(millimetres), atol=1e-9)
    np.testing.assert_allclose(calm.apply(depth, INTRINSICS, rng()), depth, rtol=1e-14)


def test_incidence_is_exact_on_planes():
    for normal in ([0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.3, -0.9, 0.3]):
        normal = np.array(normal) / np.linalg.norm(normal)
        depth, rays = plane_depth(normal, 0.5 * normal[2])
        valid = np.isfinite(depth)
        inverse = np.where(valid, 1.0 / depth, 0.0)
        cosine = rays @ normal / np.linalg.norm(rays, axis=-1)
        found = np.empty(SHAPE)
        cosine_kernel(inverse, valid, INTRINSICS, found)
        np.testing.assert_allclose(found[valid], cosine[valid], atol=1e-9)


@pytest.mark.parametrize("degrees", [50.0, 70.0, 75.0, 80.0, 88.0])
def test_share_of_lost_pixels_against_the_angle(degrees):
    """Linear from 65 to 85 degrees, whichever way the surface leans."""
    lean = np.deg2rad(degrees)
    expected = np.clip((degrees - 65.0) / 20.0, 0.0, 1.0)
    for way in ([1.0, 0.0], [0.0, -1.0], [0.6, 0.8]):
        normal = np.array([np.sin(lean) * way[0], np.sin(lean) * way[1], np.cos(lean)])
        # Only the middle of the image sees the plane at this angle, so look at that alone.
        depth, rays = plane_depth(normal, 0.4 * np.cos(lean))
        angle = np.rad2deg(np.arccos(rays @ normal / np.linalg.norm(rays, axis=-1)))
        near = (np.abs(angle - degrees) < 1.0) & np.isfinite(depth)
        noise = DepthNoise(edge_disparity=50.0)
        lost = [(noise.apply(depth, K, rng(seed)) == 0.0)[near] for seed in range(8)]
        assert np.mean(lost) == pytest.approx(expected, abs=0.025)


def step_image():
    """A near square at 0.4 m before a wall at 0.8 m, and a strip of nothing."""
    depth = np.full(SHAPE, 0.8)
    depth[80:160, 100:200] = 0.4
    depth[:, 300:] = np.inf
    return depth


def beside_edges():
    """Pixels of the step image with a four-neighbour on another surface, by plain loops."""
    depth = step_image()
    found = np.zeros(SHAPE, dtype=bool)
    for i in range(SHAPE[0]):
        for j in range(SHAPE[1]):
            for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                inside = 0 <= a < SHAPE[0] and 0 <= b < SHAPE[1]
                found[i, j] |= inside and depth[a, b] != depth[i, j]
    return found & np.isfinite(depth)


def test_pixels_fly_and_get_lost_at_edges_and_only_there():
    depth, edges = step_image(), beside_edges()
    noise = DepthNoise(subpixel=0.0, disparity_step=0.0, depth_step=0.0)
    images = np.array([noise.apply(depth, INTRINSICS, rng(seed)) for seed in range(20)])
    away = ~edges
    np.testing.assert_allclose(images[:, away], np.broadcast_to(depth[away], (20, away.sum())))
    lost = images[:, edges] == 0.0
    flying = ~lost & (np.abs(images[:, edges] - depth[edges]) > 1e-6)
    assert lost.mean() == pytest.approx(0.3, abs=0.02)
    assert flying.mean() == pytest.approx(0.3, abs=0.02)
    # Between the two surfaces, evenly in disparity; towards nothing, behind the wall.
    square = edges & (depth == 0.4)
    mixed = images[:, square][np.abs(images[:, square] - 0.4) > 1e-6]
    mixed = mixed[mixed > 0.0]
    assert mixed.min() >= 0.4 and mixed.max() <= 0.8
    assert np.mean(1 / mixed) == pytest.approx((1 / 0.4 + 1 / 0.8) / 2, abs=0.03)
    border = images[:, :, 299][images[:, :, 299] > 0.0]
    assert border.min() >= 0.8 - 1e-9 and border.max() > 1.0


NEAR, FAR = 0.15, 3.0


def too_near(true):
    """What a renderer makes of true depths: 0 where they are too near, infinite where too far."""
    return np.where(true < NEAR, 0.0, np.where(true > FAR, np.inf, true))


def test_where_a_surface_comes_too_near_its_rim_is_no_edge():
    """A wall that leans into the least depth: the pixels at the rim stay on the wall."""
    normal = np.array([np.sin(0.5), 0.0, np.cos(0.5)])
    true, _ = plane_depth(normal, 0.18 * np.cos(0.5))
    depth = too_near(true)
    assert (depth == 0.0).sum() > 4000
    calm = DepthNoise(subpixel=0.0, disparity_step=0.0, depth_step=0.0)
    for seed in range(5):
        out = calm.apply(depth, INTRINSICS, rng(seed), near=NEAR, far=FAR)
        beside = np.zeros(SHAPE, dtype=bool)
        beside[:, :-1] = (depth[:, 1:] == 0.0) & (depth[:, :-1] > 0.0)
        beside[:, 1:] |= (depth[:, :-1] == 0.0) & (depth[:, 1:] > 0.0)
        assert beside.sum() > 200
        np.testing.assert_allclose(out[beside], depth[beside], atol=1e-9)
    # Where nobody says what "too near" is, nothing flies either.
    unknown = calm.apply(depth, INTRINSICS, rng())
    np.testing.assert_allclose(unknown[beside], depth[beside], atol=1e-9)


def test_behind_something_too_near_pixels_fly_towards_it():
    true = step_image()
    true[80:160, 100:200] = 0.1
    calm = DepthNoise(subpixel=0.0, disparity_step=0.0, depth_step=0.0)
    images = np.array(
        [calm.apply(too_near(true), INTRINSICS, rng(k), near=NEAR, far=FAR) for k in range(10)]
    )
    ring = np.zeros(SHAPE, dtype=bool)
    ring[80:160, [99, 200]] = ring[[79, 160], 100:200] = True
    seen = images[:, ring][images[:, ring] > 0.0]
    flying = seen[np.abs(seen - 0.8) > 1e-9]
    assert len(flying) / images[:, ring].size == pytest.approx(0.3, abs=0.05)
    assert flying.min() >= NEAR and flying.max() < 0.8


@pytest.mark.parametrize("seed", range(5))
def test_nothing_comes_out_beyond_the_depth_range(seed):
    """Random depths, the whole range and more: there are edges to all sides, and noise at both."""
    generator = rng(seed)
    depth = too_near(1.0 / generator.uniform(1 / 20.0, 1 / 0.12, SHAPE))
    depth[generator.random(SHAPE) < 0.1] = 0.15
    depth[generator.random(SHAPE) < 0.1] = 3.0
    noise = DepthNoise(depth_step=0.0)
    out = noise.apply(depth.astype(np.float32), K, generator, near=NEAR, far=FAR)
    measured = out[(out != 0.0) & np.isfinite(out)]
    assert len(measured) > 1000
    assert measured.min() >= np.float32(NEAR) and measured.max() <= np.float32(FAR)
    assert (out[depth == 0.0] == 0.0).all() and np.isinf(out[np.isinf(depth)]).all()
    assert (out[depth == 0.15] == 0.0).any() and np.isinf(out[depth == 3.0]).any()


def test_a_slope_is_no_edge():
    depth, _ = plane_depth(np.array([np.sin(1.0), 0.0, np.cos(1.0)]), 0.5 * np.cos(1.0))
    noise = DepthNoise(
        subpixel=0.0, disparity_step=0, depth_step=0, grazing_start_deg=90, grazing_end_deg=91
    )
    near = depth < 2.0
    np.testing.assert_allclose(noise.apply(depth, K, rng())[near], depth[near])


def test_invalid_pixels_stay_as_they_are_and_types_are_kept():
    depth = np.full(SHAPE, 0.5, dtype=np.float32)
    depth[0, 0], depth[5, 5], depth[9, 9] = 0.0, np.nan, np.inf
    out = DepthNoise().apply(depth, K, rng())
    assert out.dtype == np.float32
    assert out[0, 0] == 0.0 and np.isnan(out[5, 5]) and np.isinf(out[9, 9])
    assert not np.isnan(np.delete(out.ravel(), 5 * SHAPE[1] + 5)).any()
    assert depth[1, 1] == np.float32(0.5)


def test_equal_seeds_give_equal_images():
    depth = step_image()
    first, again = (DepthNoise().apply(depth, K, rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, DepthNoise().apply(depth, K, rng(4)))
    np.testing.assert_array_equal(first, DepthNoise().apply(depth, INTRINSICS, rng(3)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"subpixel": -1.0}, "subpixel = -1"),
        ({"baseline": 0.0}, "baseline = 0"),
        ({"flying": 0.7, "edge_missing": 0.4}, "1 at most"),
        ({"grazing_start_deg": 80.0, "grazing_end_deg": 70.0}, "less than"),
        ({"depth_step": np.nan}, "depth_step"),
    ],
)
def test_parameters_out_of_range_are_refused(change, message):
    with pytest.raises(CameraError, match=message):
        DepthNoise(**change)


def test_a_wrong_image_or_camera_is_refused():
    with pytest.raises(CameraError, match=r"shape \(4,\); give \(h, w\)"):
        DepthNoise().apply(np.ones(4), K, rng())
    with pytest.raises(CameraError, match="positive focal lengths"):
        DepthNoise().apply(np.ones(SHAPE), (0.0, 1.0, 2.0, 3.0), rng())


def test_correlated_noise_is_as_large_and_resembles_its_neighbours():
    """Two Gaussian windows overlap by exp(-d^2 / (4 w^2)): the autocorrelation, by hand."""
    depth = np.full((480, 640), 0.5)
    plain = {"disparity_step": 0.0, "depth_step": 0.0}
    errors = {}
    for width in (0.0, 2.0):
        noise = DepthNoise(correlation=width, **plain)
        errors[width] = 1.0 / noise.apply(depth, INTRINSICS, rng()) - 2.0
    assert np.std(errors[2.0]) == pytest.approx(np.std(errors[0.0]), rel=0.05)
    for apart in (1, 3, 6):
        for width, expected in ((0.0, 0.0), (2.0, np.exp(-(apart**2) / 16.0))):
            one, other = errors[width][:, :-apart], errors[width][:, apart:]
            found = np.corrcoef(one.ravel(), other.ravel())[0, 1]
            assert found == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("blur", [1.0, 3.0])
def test_motion_blur_widens_the_edges(blur):
    """Pixels lost or flying reach so much farther from the square's rim, and no farther."""
    depth = step_image()
    reliable = DepthNoise(
        subpixel=0.0, disparity_step=0.0, depth_step=0.0, flying=0.0, edge_missing=1.0
    )
    lost = {b: noise_of(reliable, b).apply(depth, INTRINSICS, rng()) == 0.0 for b in (0.0, blur)}
    inside = np.s_[80:160, 100:200]
    widths = {b: np.flatnonzero(~lost[b][inside][40])[0] for b in lost}
    assert widths == {0.0: 1, blur: 1 + blur}
    row = np.flatnonzero(~lost[blur][40, :300])  # the wall, out of the square's rows
    assert row[0] == 0 and row[-1] == 299 - 1 - blur


def noise_of(noise, blur):
    return dataclasses.replace(noise, motion_blur=blur)


def test_smeared_pixels_fly_between_the_two_surfaces():
    flies = DepthNoise(0.05, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, motion_blur=2.0)
    image = flies.apply(step_image(), INTRINSICS, rng())
    band = image[100:140, 100:103]
    assert ((band > 0.4) & (band < 0.8)).all()
    np.testing.assert_allclose(image[100:140, 103:110], 0.4)


def test_images_are_dropped_whole():
    depth, noise = np.full((4, 5), 0.5), DepthNoise(dropped=0.3)
    dropped = [not noise.apply(depth, INTRINSICS, rng(seed)).any() for seed in range(400)]
    assert np.mean(dropped) == pytest.approx(0.3, abs=0.07)
    kept = [seed for seed in range(400) if not dropped[seed]]
    for seed in kept[:5]:  # the others are as they are without
        plain = DepthNoise().apply(depth, INTRINSICS, rng(seed))
        np.testing.assert_array_equal(noise.apply(depth, INTRINSICS, rng(seed)), plain)


def test_disparities_are_smeared_at_edges_as_the_mean_of_a_window_says():
    """Across a step, by hand; nothing elsewhere."""
    depth = np.full((40, 60), 0.8)
    depth[:, 30:] = 0.4
    exact = DepthNoise(
        subpixel=0.0, disparity_step=0.0, depth_step=0.0, flying=0.0, edge_missing=0.0, smear=5.0
    )
    found = exact.apply(depth, INTRINSICS, rng())
    near, far = 1.0 / 0.4, 1.0 / 0.8
    shares = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])  # of 5 pixels, the nearer surface's
    np.testing.assert_allclose(1.0 / found[20, 27:33], far + shares * (near - far), atol=1e-9)
    np.testing.assert_allclose(found[:, :27], 0.8)
    depth[10:20, 40:50] = 0.0  # nothing is measured there: no surface, and no edge of one
    again = exact.apply(depth, INTRINSICS, rng())
    np.testing.assert_array_equal(again[:, :33], found[:, :33])
    np.testing.assert_allclose(again[again[:, 36] > 0.0, 36], 0.4)
    plain = dataclasses.replace(exact, smear=0.0)
    np.testing.assert_allclose(plain.apply(depth, INTRINSICS, rng()), depth)
