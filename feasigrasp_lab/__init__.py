"""Experiments: runs, metrics, result files, replays."""
