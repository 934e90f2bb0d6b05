"""The shape of what is seen: Gaussian process distance fields."""
