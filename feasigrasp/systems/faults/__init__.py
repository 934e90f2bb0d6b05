"""Systems that let something go wrong, between two others, and where they go."""
