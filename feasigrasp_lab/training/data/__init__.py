"""Data to train and judge on: generated shapes, views and labels."""
