"""Systems that watch the others: what is going on, how well, and how it looks."""
