"""What is shown beside the tests: bounds, determinism, load, mutants, coverage, and public models."""
