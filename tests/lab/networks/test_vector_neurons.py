"""Vector neurons: equivariance to rounding, and that the checks would notice if there were none."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from feasigrasp_lab.networks import (
    VectorLinear,
    VectorLinearReLU,
    across,
    lengths,
    squared_length,
    unit,
    with_mean,
)

LAYERS = {
    "linear": lambda: VectorLinear(5, 7),
    "cut off": lambda: VectorLinearReLU(5, 7),
}


def made(name):
    torch.manual_seed(1)
    return LAYERS[name]().double()


def vectors(seed, n=20, channels=5):
    return torch.tensor(np.random.default_rng(seed).normal(size=(3, n, channels)))


def rotated(x, R):
    return torch.einsum("ij,jnc->inc", R, x)


def rotation(seed):
    return torch.tensor(Rotation.random(random_state=seed).as_matrix())


def equivariance_error(layer, seed):
    x, R = vectors(seed), rotation(seed)
    return float((layer(rotated(x, R)) - rotated(layer(x), R)).detach().abs().max())


@pytest.mark.parametrize("name", LAYERS)
@given(seed=st.integers(0, 2**31 - 1))
@settings(max_examples=20)
def test_layers_turn_with_their_input(name, seed):
    assert equivariance_error(made(name), seed) < 1e-12


@pytest.mark.parametrize("scale", [1e-12, 1e-4, 1e6])
def test_equivariance_does_not_depend_on_the_scale(scale):
    """An epsilon in a denominator would show at small scales."""
    layer, x, R = made("cut off"), scale * vectors(3), rotation(3)
    error = (layer(rotated(x, R)) - rotated(layer(x), R)).detach().abs().max()
    assert error < 1e-12 * scale
    torch.testing.assert_close(layer(x), scale * layer(vectors(3)), rtol=1e-9, atol=0.0)


def test_a_bias_would_be_noticed():
    layer = made("linear")
    biased = lambda x: layer(x) + torch.tensor([1e-6, 0.0, 0.0]).reshape(3, 1, 1)  # noqa: E731
    assert equivariance_error(biased, 4) > 1e-7


def test_a_nonlinearity_of_coordinates_would_be_noticed():
    layer = made("linear")
    assert equivariance_error(lambda x: torch.relu(layer(x)), 5) > 1e-2


def test_the_half_space_is_cut_off():
    layer, x = made("cut off"), vectors(6)
    p, d = layer.mix(x).split((7, 1), dim=-1)
    d = d.expand_as(p)
    y = layer(x)
    kept = (p * d).sum(0) >= 0.0
    assert 0.2 < kept.double().mean() < 0.8
    torch.testing.assert_close(y[:, kept], p[:, kept])
    dot, p_dot = (y * d).sum(0)[~kept], (p * d).sum(0)[~kept]
    assert (dot.abs() < 1e-12 * p_dot.abs().max()).all()
    # What is taken away lies along d.
    taken = (p - y)[:, ~kept]
    assert torch.linalg.cross(taken, d[:, ~kept], dim=0).abs().max() < 1e-12


def test_no_direction_takes_nothing_and_gradients_stay_finite():
    layer = made("cut off")
    x = torch.zeros(3, 4, 5, dtype=torch.float64, requires_grad=True)
    y = layer(x)
    assert torch.equal(y, torch.zeros_like(y))
    (y.sum() + lengths(y).sum() + unit(y.movedim(0, -1)).sum()).backward()
    assert torch.isfinite(x.grad).all()
    assert torch.isfinite(layer.mix.weight.grad).all()
    assert torch.isinf(squared_length(x)).all()


def test_points_are_independent_but_for_the_mean():
    layer, x = made("cut off"), vectors(7)
    order = torch.randperm(20)
    # To rounding: which points a processor sums at once depends on its vector width.
    torch.testing.assert_close(layer(x[:, order]), layer(x)[:, order], rtol=0, atol=1e-14)
    both = with_mean(x)
    torch.testing.assert_close(both[:, 3, 5:], x.mean(1))
    assert torch.equal(both[..., :5], x)


def test_unit_lengths_and_across():
    x = torch.randn(10, 3, dtype=torch.float64)
    axes = unit(torch.randn(10, 3, dtype=torch.float64))
    torch.testing.assert_close(unit(x).norm(dim=-1), torch.ones(10, dtype=torch.float64))
    assert torch.equal(unit(torch.zeros(3)), torch.zeros(3))
    y = across(x, axes)
    assert ((y * axes).sum(-1)).abs().max() < 1e-15
    torch.testing.assert_close(lengths(vectors(8)), torch.linalg.vector_norm(vectors(8), dim=0))
