"""Decoding on a GPU (issue 57, item 4): not measured yet.

The transport form of 3DNTC is one adaptive range-coded codeword (spec clause 11.9), which a GPU would decode with one thread; the
bake to BC7 has no kernel here.
"""

from __future__ import annotations

from collections.abc import Iterator

from .rows import Context, Row


def measure(context: Context) -> Iterator[Row]:
    """One row that says that nothing is measured."""
    yield Row("decode/all", {"skipped": "decoding on the GPU is not measured: the transport form is one adaptive codeword, "
                                        "serial by its syntax, and no kernel bakes to BC7"})
