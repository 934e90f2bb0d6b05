"""What is expected behind the seen side: pictures, nodes, and the field that they make."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.view_image import SIDE, view_image
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.shape.completion import (
    complete_shape,
    hidden_nodes,
)
from feasigrasp.models.shape.hidden_side import (
    FEATURES,
    BackSurface,
    HiddenSide,
    estimated_thickness,
    features,
    picture_scale,
)
from feasigrasp.models.weights_file import WEIGHTS, WeightsError
from feasigrasp_lab.training.train_hidden_side import HiddenSideNetwork, export

VOXEL_SIZE = 0.005
RADIUS = 0.04
CAMERA = np.array([0.0, 0.0, 0.5])


class Ball:
    """Knows that what it looks at is a ball at the origin."""

    def back_surfaces(self, images, field):
        return [self._back(image) for image in images]

    @staticmethod
    def _back(image):
        rays = image.rays() / np.linalg.norm(image.rays(), axis=-1, keepdims=True)
        towards = rays @ image.X_OC[:3, :3].T @ -image.X_OC[:3, 3]
        square = towards**2 - image.X_OC[:3, 3] @ image.X_OC[:3, 3] + RADIUS**2
        far = towards + np.sqrt(np.maximum(square, 0.0))
        depth = far * rays[..., 2]
        return BackSurface(np.where(image.mask, depth, 0.0), np.where(image.mask, 1e-3, 0.0))


def front(camera, count=6000):
    points = RADIUS * sphere_points(count, 1.0)
    return points[points @ camera > RADIUS**2]


def field_of(points, camera):
    cloud = FusedCloud.empty(VOXEL_SIZE, smooth=True).merged(points, camera)
    return complete_shape(cloud, learnt=False)


@pytest.fixture(scope="module")
def image():
    return view_image(front(CAMERA), CAMERA)


@pytest.fixture(scope="module")
def field():
    return field_of(front(CAMERA), CAMERA)


def test_the_believed_thickness_is_where_the_field_ends(image, field):
    thickness, apart = estimated_thickness(image, field)
    known = np.isfinite(thickness)
    assert known[image.mask].mean() > 0.8  # every eighth pixel is on the rim
    assert not known[~image.mask].any()
    pixels = np.nonzero(known[::2, ::2])
    pixels = 2 * pixels[0], 2 * pixels[1]
    ends = image.unproject(pixels, image.depth[pixels] + thickness[pixels])
    assert np.quantile(np.abs(field.distance(ends)), 0.9) < 1e-3
    observed = np.linalg.norm(ends[:, None] - field.points[None], axis=-1).min(axis=1)
    np.testing.assert_allclose(apart[pixels], observed, atol=1e-9)


def test_features_do_not_depend_on_the_frame(image, field):
    X = se3.random_pose(np.random.default_rng(0), 1)[0]
    turned = field_of(front(CAMERA) @ X[:3, :3].T + X[:3, 3], X[:3, :3] @ CAMERA + X[:3, 3])
    a, b = features(image, field), features(image.moved(X), turned)
    np.testing.assert_allclose(a[:4], b[:4], atol=1e-6)
    both = (a[5] == 1.0) & (b[5] == 1.0)
    assert both.sum() > 0.95 * a[5].sum()
    assert np.abs(a[4] - b[4])[both].mean() < 0.02  # other voxels, other points
    assert picture_scale(image) == pytest.approx(RADIUS * SIDE / (SIDE - 8), rel=0.1)


def test_a_larger_object_farther_away_differs_in_its_size_alone(image, field):
    larger = view_image(1.5 * front(CAMERA), 1.5 * CAMERA)
    a, b = features(image, field), features(larger, field)
    np.testing.assert_allclose(a[:3], b[:3], atol=1e-6)
    np.testing.assert_allclose((b - a)[3][image.mask], np.log(1.5), atol=1e-6)


def test_nodes_lie_on_the_hidden_side_of_a_ball(image):
    nodes, _ = hidden_nodes(None, [image], front(CAMERA), Ball(), 100)
    assert 50 < len(nodes) <= 100
    radii = np.linalg.norm(nodes, axis=1)
    np.testing.assert_allclose(radii, RADIUS, atol=5e-4)
    assert (nodes[:, 2] < 0.01).all()


def test_nodes_keep_off_what_was_observed(image):
    everything = RADIUS * sphere_points(6000, 1.0)
    some = everything[everything[:, 0] > 0.0]
    nodes, _ = hidden_nodes(None, [image], some, Ball(), 100)
    apart = np.linalg.norm(nodes[:, None] - some[None], axis=-1).min(axis=1)
    assert apart.min() > 3e-3
    assert len(nodes) > 10


def test_nodes_of_several_pictures_keep_farther_off(image):
    side = np.array([0.5, 0.0, 0.0])
    pictures = [image, view_image(front(side), side)]
    observed = np.concatenate([front(CAMERA), front(side)])
    nodes, _ = hidden_nodes(None, pictures, observed, Ball(), 100)
    apart = np.linalg.norm(nodes[:, None] - observed[None], axis=-1).min(axis=1)
    assert apart.min() > 10e-3
    assert len(nodes) > 10


class Deep:
    """Believes that everything reaches back 20 cm."""

    def back_surfaces(self, images, field):
        return [
            BackSurface(*(np.where(image.mask, part, 0.0) for part in (image.depth + 0.2, 1e-3)))
            for image in images
        ]


def test_a_picture_from_the_side_contradicts_what_it_looks_through(image):
    assert len(hidden_nodes(None, [image], front(CAMERA), Deep(), 100)[0]) > 50
    side = np.array([0.5, 0.0, 0.0])
    beside = view_image(front(side), side)
    nodes, _ = hidden_nodes(None, [image, beside], front(CAMERA), Deep(), 100)
    assert not (nodes[:, 2] < -0.1).any()


def test_a_weights_file_comes_back(tmp_path, image, field):
    torch.manual_seed(0)
    network = export(HiddenSideNetwork())
    network.save(tmp_path / "weights.npz")
    again = HiddenSide.load(tmp_path / "weights.npz")
    for before, after in zip(
        vars(network.back_surfaces([image], field)[0]).values(),
        vars(again.back_surfaces([image], field)[0]).values(),
        strict=True,
    ):
        np.testing.assert_array_equal(before, after)


def test_an_untrained_network_believes_the_field(image, field):
    (back,) = export(HiddenSideNetwork()).back_surfaces([image], field)
    estimated, _ = estimated_thickness(image, field)
    known = np.isfinite(estimated)
    change = (back.depth - image.depth)[known] - estimated[known]
    np.testing.assert_allclose(change, change[0], atol=1e-6)


@pytest.mark.parametrize("channels", [(32, 64, 96), (4, 8)])
def test_it_computes_what_is_trained_with_torch(channels):
    torch.manual_seed(1)
    trained = HiddenSideNetwork(channels)
    torch.nn.init.normal_(trained.head.weight, std=30.0)
    picture = np.random.default_rng(2).normal(size=(FEATURES, SIDE, SIDE)).astype(np.float32)
    with torch.inference_mode():
        expected = trained(torch.from_numpy(picture[None]))
    for ours, theirs in zip(export(trained).thickness(picture), expected, strict=True):
        assert theirs.std() > 0.1
        np.testing.assert_allclose(ours, theirs[0], atol=1e-4)


def test_weights_of_something_else_are_refused(tmp_path):
    with pytest.raises(WeightsError, match=r"format is 'feasigrasp grasp_network 1', not"):
        HiddenSide.load(WEIGHTS / "grasp_network.npz")
    with np.load(WEIGHTS / "hidden_side.npz") as good:
        arrays = {**good, "head.weight": np.zeros((3, 32, 1, 1), dtype=np.float32)}
    np.savez(tmp_path / "wide.npz", **arrays)
    with pytest.raises(WeightsError, match=r"does not hold hidden side weights.*head.weight"):
        HiddenSide.load(tmp_path / "wide.npz")
    with pytest.raises(WeightsError, match=r"no hidden side weights .*train hidden-side"):
        HiddenSide.load(tmp_path / "none.npz")


def test_fields_load_torch_when_they_look_at_the_hidden_side_only():
    names = "completion", "gpdf", "scene_field"
    imports = ", ".join(f"feasigrasp.models.shape.{name}" for name in names)
    code = f"import sys, {imports}\nprint({{'torch', 'pydrake', 'open3d'}} & set(sys.modules))"
    command = [sys.executable, "-c", code]
    assert subprocess.run(command, capture_output=True, text=True).stdout == "set()\n"
