"""What a run is judged by: figures of its samples, its ticks and the object in it."""
