"""Runs over driver messages in two processes, with a network between that fails."""
