"""The makers of the vectors, and of what the specification says by tables."""
