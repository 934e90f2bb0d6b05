"""Camera recordings, and the evaluation of trackers on them."""
