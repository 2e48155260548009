"""Evidence beside the tests: bounds, determinism, mutants, coverage, and public models."""
