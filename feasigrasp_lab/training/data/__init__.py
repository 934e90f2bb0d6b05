"""Training and evaluation data: generated shapes, views and labels."""
