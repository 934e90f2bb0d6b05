"""Riemannian mixtures of rigid motions."""
