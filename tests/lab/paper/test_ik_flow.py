"""The IK flow against autograd, forward kinematics and its own inverse."""

import copy
import json
import subprocess
import sys
from dataclasses import asdict

import numpy as np
import pytest
import torch
from scipy.stats import kstest

from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.weights_file import WeightsError
from feasigrasp_lab.arm import in_collision
from feasigrasp_lab.paper.ik_flow import DEFAULT_WEIGHTS, IkFlow, load_ik_flow
from feasigrasp_lab.paper.ik_flow_layers import (
    FEATURES,
    FlowShape,
    features_kernel,
    turn_kernel,
)
from feasigrasp_lab.training.train_ik_flow import IkFlowNetwork

SMALL = FlowShape(components=(6, 3, 2, 1, 2, 3, 2), hidden=((16, 16),) * 7, narrowest=0.01)


def random_configurations(n, seed=0):
    return IIWA_7.random_positions(np.random.default_rng(seed), n)


def reachable_poses(n, seed=0):
    q = random_configurations(2 * n, seed)
    return forward_kinematics(q[~in_collision(q)][:n])


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(3)
    network = IkFlowNetwork(SMALL)
    with torch.no_grad():  # far from the even mixtures it starts with
        for parameter in network.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    return network


@pytest.fixture(scope="module")
def small_flow(network):
    return IkFlow(SMALL, {name: w.numpy() for name, w in network.state_dict().items()})


@pytest.fixture(scope="module")
def flow():
    return load_ik_flow()


def forward(flow, X, q):
    """Latents (n, 7) and log densities (n,) of configurations, by the torch network."""
    network = IkFlowNetwork(flow.shape)
    network.load_state_dict({name: torch.from_numpy(w.copy()) for name, w in flow.arrays.items()})
    with torch.no_grad():
        u, log_derivative = network.double()(torch.tensor(q), torch.tensor(X))
    return u.numpy(), log_derivative.sum(1).numpy()


def test_inverse_undoes_the_torch_network(small_flow):
    X = reachable_poses(300)
    u = np.random.default_rng(1).random((300, 7))
    q = small_flow.inverse(X, u)
    np.testing.assert_allclose(forward(small_flow, X, q)[0], u, atol=1e-5)
    q = random_configurations(300, seed=2)  # of other poses: the map is onto, whatever the pose
    u, _ = forward(small_flow, X, q)
    assert ((u > 0.0) & (u < 1.0)).all()
    back = small_flow.inverse(X, u)
    np.testing.assert_allclose(forward(small_flow, X, back)[0], u, atol=1e-5)
    # Where the density is next to nothing, rounding of the latent moves the configuration.
    assert np.median(np.abs(back - q)) < 1e-5


def test_log_density_is_the_log_determinant_of_the_jacobian(network):
    exact = copy.deepcopy(network).double()
    X, q = torch.tensor(reachable_poses(20, seed=6)), torch.tensor(random_configurations(20, 7))
    for pose, configuration in zip(X, q, strict=True):
        J = torch.autograd.functional.jacobian(
            lambda x, pose=pose: exact(x[None], pose[None])[0][0], configuration
        )
        assert J.triu(1).abs().max() == 0.0  # a joint's latent depends on the joints before it
        assert (J.diagonal() > 0.0).all()
        log_density = exact(configuration[None], pose[None])[1].sum()
        assert torch.linalg.slogdet(J)[1].item() == pytest.approx(log_density.item(), abs=1e-8)


def test_latents_are_zero_and_one_at_the_limits(small_flow):
    X = reachable_poses(50, seed=8)
    for sign, expected in ((-1.0, 0.0), (1.0, 1.0)):
        u, _ = forward(small_flow, X, np.tile(sign * IIWA_7.upper, (50, 1)))
        np.testing.assert_allclose(u, expected, atol=1e-9)


def test_targets_end_at_the_flange():
    q = random_configurations(20, seed=9)
    target = np.ascontiguousarray(forward_kinematics(q)[:, :3])
    features, azimuth = np.empty((20, FEATURES), dtype=np.float32), np.empty(20)
    for joint in range(7):
        features_kernel(target, joint, features, azimuth)
        turn_kernel(target, joint, q[:, joint].copy())
    expected = np.eye(4)[:3]
    expected[2, 3] = IIWA_7.link_steps[-1]
    np.testing.assert_allclose(target, np.broadcast_to(expected, (20, 3, 4)), atol=1e-12)


def test_turning_the_pose_about_the_base_turns_the_first_joint(small_flow):
    """The latent of the same q1, turned along, changes by what the limits cut off alone."""
    X, q = reachable_poses(40, seed=10), 0.5 * random_configurations(40, seed=11)
    turn = 0.3
    turned = se3.make_pose(se3.so3_exp([0.0, 0.0, turn]), np.zeros(3)) @ X
    along = q + turn * np.eye(7)[0]
    log_ratio = forward(small_flow, turned, along)[1] - forward(small_flow, X, q)[1]
    # The other joints see the very same target: their densities cancel.
    u, v = forward(small_flow, X, q)[0], forward(small_flow, turned, along)[0]
    np.testing.assert_allclose(u[:, 1:], v[:, 1:], atol=1e-5)
    assert np.abs(log_ratio).max() < 0.5


def test_the_trained_flow_is_calibrated(flow):
    """Latents of true configurations are uniform if the flow is the true distribution.

    Of joint 1 alone: the others take one of a few values, sharper than the flow's least scale.
    """
    q = random_configurations(4000, seed=12)
    q = q[~in_collision(q)]
    u, log_density = forward(flow, forward_kinematics(q), q)
    assert kstest(u[:, 0], "uniform").statistic < 0.04
    # Uniform over the limits, it would be minus the logarithm of their volume.
    assert log_density.mean() > -np.log(2.0 * IIWA_7.upper).sum() + 25.0


def test_samples_are_inside_the_limits_and_close_to_their_poses(flow):
    X = reachable_poses(300, seed=13)
    q = flow.sample(X)
    assert q.shape == (300, 7)
    assert (np.abs(q) <= IIWA_7.upper).all()
    error = np.linalg.norm(forward_kinematics(q)[:, :3, 3] - X[:, :3, 3], axis=-1)
    assert np.median(error) < 0.02


def test_three_steps_bring_most_solutions_onto_their_poses(flow):
    X = reachable_poses(1000, seed=14)
    q = flow.solve(X)
    assert (np.abs(q) <= IIWA_7.upper).all()
    reached = forward_kinematics(q)
    position = np.linalg.norm(reached[:, :3, 3] - X[:, :3, 3], axis=1)
    angle = se3.rotation_angle(np.swapaxes(reached[:, :3, :3], 1, 2) @ X[:, :3, :3])
    assert ((position < 1e-3) & (angle < np.deg2rad(1.0))).mean() > 0.9


def test_the_same_seed_gives_the_same_solutions(flow):
    X = reachable_poses(50, seed=15)
    np.testing.assert_array_equal(flow.solve(X, seed=4), flow.solve(X, seed=4))
    assert np.abs(flow.solve(X, seed=4) - flow.solve(X, seed=5)).max(axis=1).min() > 1e-3


def test_solutions_move_smoothly_with_the_pose(flow):
    """Along a path in steps of 2 mm and 0.2 degrees, hardly a solution jumps."""
    steps, n = 50, 40
    turn = se3.so3_exp(np.deg2rad(0.2) * np.array([0.6, 0.0, 0.8]))
    X = reachable_poses(n, seed=16)
    inside = np.linalg.norm(X[:, :3, 3] - [0.0, 0.0, 0.34], axis=1) < 0.7
    X, path = X[inside], []
    for _ in range(steps):
        path.append(flow.solve(X))
        X = X.copy()
        X[:, 0, 3] += 0.002
        X[:, :3, :3] = turn @ X[:, :3, :3]
    moved = np.abs(np.diff(path, axis=0)).max(axis=2)
    assert np.median(moved) < 0.02
    assert (moved > 0.2).mean() < 0.03


def test_samples_of_a_pose_are_diverse(flow):
    q = flow.sample(np.repeat(reachable_poses(30, seed=17), 64, axis=0)).reshape(30, 64, 7)
    branches = [{tuple(row) for row in (samples[:, [1, 3, 5]] > 0.0)} for samples in q]
    assert np.mean([len(found) for found in branches]) > 6.0


def test_no_poses_give_no_solutions(flow):
    assert flow.solve(np.empty((0, 4, 4))).shape == (0, 7)


@pytest.mark.parametrize("X", [np.eye(4), np.full((2, 4, 4), np.nan), np.zeros((2, 3, 4))])
def test_wrong_poses_are_refused(flow, X):
    with pytest.raises(ValueError, match="X_WF .* shape"):
        flow.sample(X)


def test_latents_out_of_range_are_refused(flow):
    with pytest.raises(ValueError, match="latents"):
        flow.inverse(reachable_poses(1), np.full((1, 7), 1.1))


def test_loaded_is_what_was_saved(small_flow, tmp_path):
    small_flow.save(tmp_path / "weights.npz")
    assert [file.name for file in tmp_path.iterdir()] == ["weights.npz"]
    loaded = IkFlow.load(tmp_path / "weights.npz")
    assert loaded.shape == small_flow.shape
    X = reachable_poses(10)
    np.testing.assert_array_equal(loaded.sample(X), small_flow.sample(X))


def test_the_default_is_loaded_once_and_never_copied(flow):
    assert load_ik_flow() is flow
    assert copy.deepcopy(flow) is flow
    assert DEFAULT_WEIGHTS.stat().st_size < 10e6


def broken_files():
    def header(**changes):
        content = {"format": "feasigrasp ik_flow 1", "shape": asdict(SMALL), **changes}
        return np.array(json.dumps(content))

    shape = asdict(SMALL)
    name = "factors.2.head.weight"
    return [
        ("no header", lambda arrays: arrays.pop("header"), "header"),
        ("another format", {"header": header(format="flow 7")}, "format is 'flow 7'"),
        ("other sizes", {"header": header(shape=asdict(FlowShape()))}, "factors.0"),
        ("six joints", {"header": header(shape={**shape, "components": [1] * 6})}, "7 joints"),
        ("no scale", {"header": header(shape={**shape, "narrowest": 0.0})}, "least scale"),
        ("no text", {"header": np.array("{")}, "not hold IK flow weights"),
        ("array missing", lambda arrays: arrays.pop(name), "missing: .*factors.2"),
        ("array too many", {"extra": np.zeros(3)}, "unknown: .*extra"),
        ("array too small", {name: np.zeros((2, 2), dtype=np.float32)}, "not float32"),
        ("not finite", {name: np.full((8, 16), np.nan, dtype=np.float32)}, "not finite"),
        ("a pickle", {name: np.array([{}], dtype=object)}, "is no whole npz file"),
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [pytest.param(change, message, id=name) for name, change, message in broken_files()],
)
def test_broken_weights_are_named(small_flow, tmp_path, change, message):
    small_flow.save(tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as file:
        arrays = dict(file)
    if callable(change):
        change(arrays)
    else:
        arrays.update(change)
    np.savez(tmp_path / "broken.npz", **arrays)
    with pytest.raises(WeightsError, match=message) as caught:
        IkFlow.load(tmp_path / "broken.npz")
    assert "feasigrasp train ik-flow" in str(caught.value)


@pytest.mark.parametrize("content", [None, b"", b"no zip file at all"])
def test_missing_and_cut_files_are_named(tmp_path, content):
    path = tmp_path / "weights.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(WeightsError, match=r"weights\.npz"):
        IkFlow.load(path)


def test_half_a_file_is_named(small_flow, tmp_path):
    path = tmp_path / "weights.npz"
    small_flow.save(path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(WeightsError, match="is no whole npz file"):
        IkFlow.load(path)


def test_sampling_needs_no_torch():
    program = (
        "import sys, numpy as np; from feasigrasp_lab.paper.ik_flow import load_ik_flow;"
        "load_ik_flow().solve(np.eye(4)[None]); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True).returncode == 0
