"""What is shown beside the tests: bounds, determinism, load, mutants, coverage, and models of strangers."""
