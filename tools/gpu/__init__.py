"""Measurements on a GPU: the 3DNTC fit, frames and decoding (docs/reports/gpu.md)."""
