"""Vector neurons: layers that are equivariant to rotations (Deng et al., ICCV 2021).

After Deng, Litany, Duan, Poulenard, Tagliasacchi, Guibas, "Vector Neurons: A General Framework for
SO(3)-Equivariant Networks", ICCV 2021. A feature is a list of C vectors instead of C numbers. A
linear layer mixes vectors with scalar weights and has no bias, the nonlinearity cuts vectors at a
half space whose direction is itself such a mixture; rotating the input by R rotates every vector
by R, up to rounding and for any weights.

Layout: ``(..., 3, n, C)``, channels last, so that a linear layer is one matrix product over all
points and coordinates. No epsilon is added anywhere: where a direction vanishes it is left out.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

#: Squared lengths below the least normal float32 are zero: their direction is rounding. Source:
#: numerical.
_NOTHING = 1.2e-38


class VectorLinear(nn.Module):
    """Mixes vectors: ``v'_c = sum_k W_ck v_k``.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, inputs))
        nn.init.uniform_(self.weight, -(inputs**-0.5), inputs**-0.5)

    def forward(self, vectors: Tensor) -> Tensor:
        """From vectors (..., 3, n, inputs) to (..., 3, n, outputs)."""
        return vectors @ self.weight.T


class VectorLinearReLU(nn.Module):
    """Mixes vectors, then takes from each what points against a learned direction.

    With ``p = W v`` and the direction ``d = U v``: p where ``p . d >= 0``, and its part across d,
    ``p - (p . d / |d|^2) d``, elsewhere.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out.
        shared: Whether all channels share one direction.
    """

    def __init__(self, inputs: int, outputs: int, shared: bool = True) -> None:
        super().__init__()
        self.outputs = outputs
        self.mix = VectorLinear(inputs, outputs + (1 if shared else outputs))

    def forward(self, vectors: Tensor) -> Tensor:
        """From vectors (..., 3, n, inputs) to (..., 3, n, outputs)."""
        mixed = self.mix(vectors)
        p, d = mixed[..., : self.outputs], mixed[..., self.outputs :]
        against = (p * d).sum(-3, keepdim=True).clamp_max(0.0)
        return p - (against / squared_length(d)) * d


def squared_length(vectors: Tensor) -> Tensor:
    """Squared lengths of vectors (..., 3, n, C): (..., 1, n, C); infinite where they vanish."""
    square = (vectors * vectors).sum(-3, keepdim=True)
    return torch.where(square > _NOTHING, square, torch.inf)


def lengths(vectors: Tensor) -> Tensor:
    """Lengths (..., n, C) of vectors (..., 3, n, C), with a finite gradient at zero."""
    return (vectors * vectors).sum(-3).clamp_min(_NOTHING).sqrt()


def with_mean(vectors: Tensor) -> Tensor:
    """Appends the means over the points as further channels: (..., 3, n, 2 C)."""
    mean = vectors.mean(-2, keepdim=True)
    return torch.cat((vectors, mean.expand_as(vectors)), -1)


def unit(vectors: Tensor, dim: int = -1) -> Tensor:
    """Vectors scaled to length 1; those that vanish stay zero."""
    square = (vectors * vectors).sum(dim, keepdim=True)
    return vectors * torch.where(square > _NOTHING, square, torch.inf).rsqrt()


def across(vectors: Tensor, axes: Tensor) -> Tensor:
    """The part of vectors (..., 3) across unit axes (..., 3)."""
    return vectors - (vectors * axes).sum(-1, keepdim=True) * axes
