"""The grasp networks: equivariance to rounding, and what they propose."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.network.contact_features import DIRECTIONS, contact_features
from feasigrasp.models.grasps.network.network import (
    MODES,
    ROOM_BESIDE,
    ROOM_DEVIATIONS,
    with_room,
)
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.grasps.network.surroundings import hand_room, neighbourhoods
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.networks import Contacts, TorchGraspNetwork
from feasigrasp_lab.paper.grasp_network import NETWORKS

HAND = ParallelGripper()


def blob(seed, n=120):
    """Points, normals and scalars of a lumpy closed surface: no symmetry that could hide errors."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = direction * rng.uniform(0.02, 0.05, 3) + 0.003 * rng.normal(size=(n, 3))
    normals = direction + 0.2 * rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    chord = np.where(rng.random(n) < 0.8, rng.uniform(0.02, 0.1, n), 0.0)
    hit = chord > 0.0
    scalars = np.stack(
        [
            rng.uniform(2e-4, 0.01, n),
            chord,
            hit * rng.uniform(-1.0, -0.5, n),
            hit * rng.uniform(2e-4, 0.01, n),
        ],
        axis=1,
    )
    return points, normals, scalars


@pytest.fixture(scope="module", params=list(NETWORKS.values()))
def network(request):
    """Float64, and far from the initial weights: every path carries something."""
    module = request.param.untrained(seed=2).network
    state = copy.deepcopy(module.state_dict())
    rng = torch.Generator().manual_seed(5)
    for tensor in state.values():
        tensor.add_(0.1 * torch.randn(tensor.shape, generator=rng))
    module.load_state_dict(state)
    return request.param.of(module.double())


def rotation(seed):
    return Rotation.random(random_state=seed).as_matrix()


def proposed(network, points, normals, scalars):
    return network.propose_at(contact_features(points, normals, scalars))


def assert_moved(a, b, R, order=slice(None), tolerance=1e-9):
    """Proposals b are those of a, rotated by R and put in another order."""
    for name in ("contact", "width", "width_deviation", "approach_score"):
        np.testing.assert_allclose(getattr(b, name), getattr(a, name)[order], atol=tolerance)
    for name in ("closing", "approach"):
        np.testing.assert_allclose(getattr(b, name), getattr(a, name)[order] @ R.T, atol=tolerance)


@given(seed=st.integers(0, 2**31 - 1))
@settings(deadline=None, max_examples=10)
def test_proposals_move_with_the_object(network, seed):
    points, normals, scalars = blob(seed)
    R, p = rotation(seed), np.random.default_rng(seed).normal(size=3)
    still = proposed(network, points, normals, scalars)
    moved = proposed(network, points @ R.T + p, normals @ R.T, scalars)
    assert_moved(still, moved, R)


def test_proposals_do_not_depend_on_the_order_of_points(network):
    points, normals, scalars = blob(7)
    order = np.random.default_rng(7).permutation(len(points))
    still = proposed(network, points, normals, scalars)
    other = proposed(network, points[order], normals[order], scalars[order])
    assert_moved(still, other, np.eye(3), order)


def test_a_mirrored_object_has_mirrored_proposals(network):
    mirror = np.diag([-1.0, 1.0, 1.0])
    points, normals, scalars = blob(8)
    still = proposed(network, points, normals, scalars)
    assert_moved(still, proposed(network, points @ mirror, normals @ mirror, scalars), mirror)


@pytest.mark.parametrize("what", ["vectors", "numbers", "room", "axes", "across"])
def test_features_that_do_not_turn_would_be_noticed(what):
    """The tests above rest on every input: each of them matters, and a wrong one breaks them."""
    module = TorchGraspNetwork.untrained(seed=3).network
    network = TorchGraspNetwork.of(module.double())
    points, normals, scalars = blob(9)
    features = contact_features(points, normals, scalars)
    R = rotation(9)
    turned = contact_features(points @ R.T, normals @ R.T, scalars)
    still = network.propose_at(features)
    assert_moved(still, network.propose_at(turned), R)
    fields = {name: getattr(turned, name) for name in turned.__dataclass_fields__}
    fields[what] = fields[what] + 1e-4 * np.arange(fields[what].size).reshape(fields[what].shape)
    broken = network.propose_at(type(turned)(**fields))
    with pytest.raises(AssertionError):
        assert_moved(still, broken, R)


def test_proposals_are_grasps(network):
    a = proposed(network, *blob(10))
    modes = 1 if network.preset == "paper" else MODES
    assert a.approach.shape == (120, modes, 3)
    np.testing.assert_allclose(np.linalg.norm(a.closing, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(a.approach, axis=2), 1.0, atol=1e-12)
    assert np.abs(np.einsum("nmi,ni->nm", a.approach, a.closing)).max() < 1e-12
    assert (a.width > 0.0).all()
    assert (a.width_deviation > 0.0).all()
    for probability in (a.contact, a.approach_score):
        assert ((probability >= 0.0) & (probability <= 1.0)).all()
    assert (np.diff(a.approach_score, axis=1) <= 0.0).all()
    assert not a.closing.flags.writeable


def test_modes_are_apart():
    a = proposed(TorchGraspNetwork.untrained(seed=4), *(x.astype("f") for x in blob(11)))
    cosine = np.einsum("nki,nli->nkl", a.approach, a.approach)
    cosine[:, np.arange(MODES), np.arange(MODES)] = -1.0
    assert cosine.max() < np.cos(1.5 * 2.0 * np.pi / DIRECTIONS)


def test_untrained_grasps_close_along_the_normal_over_the_chord():
    network = TorchGraspNetwork.untrained(seed=0)
    points, normals, scalars = (x.astype(np.float32) for x in blob(12))
    a = network.propose(GraspInput(points, normals, scalars))
    assert np.einsum("ni,ni->n", a.closing, -normals).min() > 0.99
    hit = scalars[:, 1] > 0.0
    assert np.abs(a.width - scalars[:, 1])[hit].max() < 0.01


def test_a_hand_makes_room_for_a_far_contact_that_is_uncertain():
    opening = 0.085
    width = np.array([0.02, 0.05, 0.05, 0.05, 0.07, 0.08])
    deviation = np.array([0.005, 0.0, 0.007, 0.03, 0.004, 0.002])
    wider = with_room(width, deviation, opening)
    near = 0.5 * (opening - wider)  # the hand is centred on the wider one
    far = near + wider - width
    needed = ROOM_DEVIATIONS * deviation + ROOM_BESIDE
    np.testing.assert_array_equal(wider[:2], width[:2])  # there is room
    assert wider[5] == width[5]  # there is none for more
    np.testing.assert_allclose(far[2], needed[2])
    np.testing.assert_allclose(near[3:5], ROOM_BESIDE)
    assert (far[3:5] < needed[3:5]).all()
    assert (far[3:5] > near[3:5]).all()


def test_the_fused_network_is_the_torch_one():
    module = TorchGraspNetwork.untrained(seed=8).network.double()
    with torch.no_grad():
        for parameter in module.parameters():
            noise = torch.randn(parameter.shape, generator=torch.Generator())
            parameter.add_(0.1 * noise.double())
    features = contact_features(*blob(19, 133))  # no whole number of tiles
    with torch.no_grad():  # either width the likelier one at half of the contacts
        weight = module(Contacts.of(features)).weight
        lead = (weight[..., 0] - weight[..., 1]).flatten().sort().values
        module.last.bias[-1] += lead[66:68].mean()  # of none: rounding would decide it
    a = TorchGraspNetwork.of(module).propose_at(features)
    heads = module(Contacts.of(features))
    np.testing.assert_allclose(a.contact, torch.sigmoid(heads.contact[0]), atol=1e-12)
    width, spread = heads.mode_width()
    assert 0.4 < (width == heads.width[..., 0]).double().mean() < 0.6
    room = with_room(width[0].numpy(), np.sqrt(2.0) * spread[0].numpy(), HAND.max_opening)
    np.testing.assert_allclose(a.width, room, atol=1e-12)
    np.testing.assert_allclose(a.width_deviation, np.sqrt(2.0) * spread[0], atol=1e-12)
    np.testing.assert_allclose(a.closing, heads.closing[0], atol=1e-12)
    best = heads.free[0].argmax(1)
    np.testing.assert_allclose(
        a.approach_score[:, 0], torch.sigmoid(heads.free[0]).amax(1), atol=1e-12
    )
    np.testing.assert_allclose(
        a.approach[:, 0], heads.approach[0][torch.arange(133), best], atol=1e-12
    )


def test_torch_gives_chosen_contacts_as_it_gives_all():
    for kind in NETWORKS.values():
        network = kind.untrained(seed=9).network.double()
        x = Contacts.of(contact_features(*blob(20)))
        rows = torch.tensor([[3, 100, 7]])
        for all_of, chosen in zip(network(x), network(x, rows), strict=True):
            torch.testing.assert_close(chosen[0], all_of[0, rows[0]])


def test_neighbourhoods_against_a_plain_sum():
    points, normals, _ = blob(13, 40)
    confidence = np.random.default_rng(13).random(40)
    means = neighbourhoods(points, normals, points, normals, confidence, (0.012, 0.03))
    apart = points[None] - points[:, None]
    for s, radius in enumerate((0.012, 0.03)):
        near = np.maximum(1.0 - (apart**2).sum(2) / radius**2, 0.0) ** 2
        w = near * np.maximum(normals @ normals.T, 0.0)
        share = w / w.sum(1)[:, None]
        np.testing.assert_allclose(means[:, s, 0], w.sum(1))
        np.testing.assert_allclose(means[:, s, 1:4], share @ normals, atol=1e-12)
        offset = np.einsum("ij,ijk->ik", share, apart) / radius
        np.testing.assert_allclose(means[:, s, 4:7], offset, atol=1e-12)
        np.testing.assert_allclose(means[:, s, 7], share @ confidence, atol=1e-12)


def test_an_empty_neighbourhood_is_zero():
    points, normals, _ = blob(21, 10)
    means = neighbourhoods(points + 1.0, normals, points, normals, np.ones(10), (0.01,))
    assert not means.any()


def test_the_hand_has_room_where_nothing_is_in_its_way():
    """One point beside a thin plate: it blocks the fingers from one direction only."""
    contact, b, u = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])

    def room(obstacle, width=0.04):
        return hand_room(
            contact, b, u, np.array([width]), np.array([obstacle]), np.ones(1), HAND, DIRECTIONS
        )[..., 0].T

    # 4 cm behind the pads, where a finger would be for the approach of angle zero.
    beside = 0.02 + HAND.max_opening / 2 + HAND.finger_thickness / 2
    finger = room([beside, 0.0, -0.04])
    assert finger[0, 0] == pytest.approx(0.025 + HAND.finger_thickness / 2)
    assert finger[DIRECTIONS // 2, 0] < 0.025 - 0.01  # in front of the pads: out of reach
    assert finger[0, 4] == pytest.approx(finger[0, 0])  # and on the way of the closing finger
    palm = room([0.02, 0.0, HAND.heel - 0.01])
    assert palm[0, 2] == pytest.approx(0.025 + 0.01)
    assert palm[0, 0] == 0.0
    assert palm[DIRECTIONS // 2, 2] == 0.0
    # A camera in the way on one side may be on the other.
    assert room([0.02, 0.085, -0.105])[0, 5] == 0.0
    # Nothing where only the object is, between the pads.
    assert room([0.02, 0.0, 0.0])[:, :3].max() == 0.0


def test_another_hand_sees_other_room():
    network = TorchGraspNetwork.untrained(seed=6)
    surface = GraspInput(*(x.astype(np.float32) for x in blob(14)))
    wide = replace(network, gripper=ParallelGripper(max_opening=0.11, finger_width=0.02))
    a, b = network.propose(surface), wide.propose(surface)
    assert np.abs(np.sort(a.approach_score) - np.sort(b.approach_score)).max() > 1e-4


def test_bad_input_is_refused():
    points, normals, scalars = blob(15)
    with pytest.raises(GraspError, match="has none"):
        contact_features(points[:0], normals[:0], scalars[:0])
    with pytest.raises(GraspError, match="unit length"):
        contact_features(points, 1.1 * normals, scalars)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_few_points_are_enough(n):
    a = TorchGraspNetwork.untrained().propose(GraspInput(*(x.astype("f") for x in blob(16, n))))
    assert a.contact.shape == (n,)
    assert np.isfinite(a.approach).all()
