"""Elementary functions, small vectors and matrices for compiled loops."""
