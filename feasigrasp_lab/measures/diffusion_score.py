"""Error of the learned diffusion score against a mixture on SE(3) with known score."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp_lab.training.diffusion_batches import with_noise


def known_components() -> Array:
    """Three poses 0.4 rad and more apart, which noise makes overlap, shape (3, 4, 4)."""
    R = se3.so3_exp([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.0, 0.4, 0.3]])
    return se3.make_pose(R, [[0.0, 0.1, -0.2], [0.2, 0.0, 0.1], [-0.1, -0.2, 0.0]])


def log_density(components: Array, X: Array, deviation: float) -> Array:
    """Log density, but for a constant, of poses by the volume of the group, shape (n,).

    Args:
        components: Poses that are equally likely, shape (k, 4, 4).
        X: Shape (n, 4, 4).
        deviation: Of the normal noise in the tangent space of each [rad and units of length].
    """
    v = np.stack([se3.log(se3.inverse(each) @ X) for each in components])
    angle = np.linalg.norm(v[..., :3], axis=-1)
    # |det J_r| of SE(3) is that of SO(3) squared, (sin(angle / 2) / (angle / 2))^2 squared.
    volume = np.sinc(angle / (2.0 * np.pi)) ** 4
    terms = -(v**2).sum(-1) / (2.0 * deviation**2) - np.log(volume)
    return np.asarray(np.logaddexp.reduce(terms, axis=0))


def score(components: Array, X: Array, deviation: float) -> Array:
    """Gradient of `log_density` by a body twist, by central differences, shape (n, 6)."""
    # Step of the central differences [rad or units of length].
    difference = 1e-5
    found = np.empty((len(X), 6))
    for i in range(6):
        step = se3.exp(difference * np.eye(6)[i])
        ahead, behind = (
            log_density(components, X @ way, deviation) for way in (step, se3.inverse(step))
        )
        found[:, i] = (ahead - behind) / (2.0 * difference)
    return found


def relative_error(taught: Array, truth: Array) -> float:
    """How far apart least squares finds two fields of directions (n, 6) at the same poses.

    Their difference may be noise; what counts is what is left of it on average, weighed with the
    true one.
    """
    exact = truth.T @ truth
    return float(np.linalg.norm(truth.T @ taught - exact) / np.linalg.norm(exact))


def score_error(deviation: float, count: int, seed: int) -> float:
    """`relative_error` of the directions that training is given.

    Args:
        deviation: Of the noise.
        count: Noised poses.
        seed: Draws them.
    """
    rng = np.random.default_rng(seed)
    components = known_components()
    clean = components[rng.integers(len(components), size=count)]
    X, gradient = with_noise(clean, np.full(count, deviation), rng)
    return relative_error(-gradient, score(components, X, deviation))
