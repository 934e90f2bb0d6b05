"""Controllers to compare ours with, see docs/baselines.md."""
