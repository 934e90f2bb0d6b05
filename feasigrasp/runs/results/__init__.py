"""Result files: rows, statistics, where figures come from."""
