"""Runs over driver messages in two processes, with network impairment."""
