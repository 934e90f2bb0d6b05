"""Runs over the messages of the drivers: the controller, and the cell that judges it."""
