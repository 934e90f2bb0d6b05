"""Receding-horizon control: an experiment beside the controllers of the product."""
