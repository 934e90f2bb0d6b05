"""The record of a run: rows, statistics, versions, arguments of a command."""
