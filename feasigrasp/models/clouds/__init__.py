"""Point clouds: reading, checking, merging, what sensors do to them."""
