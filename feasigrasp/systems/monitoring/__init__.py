"""Systems for monitoring: status, metrics, visualization."""
