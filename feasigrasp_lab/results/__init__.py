"""Results of many runs: finished work, workers, conditions, tables."""
