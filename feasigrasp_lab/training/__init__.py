"""Training and fitting of the shipped models."""
