"""Riemannian mixtures of rigid motions."""

from feasigrasp.models.mixtures.fit import fit_best_mixture, fit_riemannian_mixture
from feasigrasp.models.mixtures.mixture import RiemannianMixture

__all__ = ["RiemannianMixture", "fit_best_mixture", "fit_riemannian_mixture"]
