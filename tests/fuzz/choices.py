"""Bytes that drive choices: whatever they are, a target makes something of them, and an empty input is as legal as any.

Small changes of the bytes make small changes of what is chosen, which is what a guided search lives on.
"""

from collections.abc import Sequence
from typing import Any

ODD_NUMBERS = (0, 1, 2, 3, 127, 128, 255, 256, 32767, 32768, 65535, 65536, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 32,
               (1 << 53) + 1, (1 << 56) - 1, 1 << 56, (1 << 63) - 1, 1 << 64)
ODD_REALS = (0.0, -0.0, 1.0, -1.0, 5e-324, 1e-300, 1e300, -1e300, 1.7976931348623157e308, float("inf"), float("-inf"),
             float("nan"))


class Choices:
    """Takes choices off the front of some bytes; where they are used up, every choice is the first."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = bytes(data), 0

    def whole(self, low: int, high: int) -> int:
        """A whole number in low..high."""
        if high <= low:
            return low
        count = ((high - low).bit_length() + 7) // 8
        return low + int.from_bytes(self.take(count), "little") % (high - low + 1)

    def flag(self, one_in: int = 2) -> bool:
        """True once in so many times; False where the bytes are used up."""
        return self.whole(0, one_in - 1) == one_in - 1

    def pick(self, options: Sequence) -> Any:
        """One of the options."""
        return options[self.whole(0, len(options) - 1)]

    def take(self, count: int) -> bytes:
        """The next so many bytes, fewer where they are used up."""
        self.at += count
        return self.data[self.at - count : self.at]

    def filled(self, count: int) -> bytes:
        """As take(), with zeros for what is missing."""
        return self.take(count).ljust(count, b"\0")

    def rest(self) -> bytes:
        """All that is left."""
        return self.take(max(len(self.data) - self.at, 0))

    def number(self) -> int:
        """A whole number of any size, often one at which something overflows."""
        number = self.pick(ODD_NUMBERS) + self.whole(0, 2) - 1
        return -number if self.flag(4) else number

    def real(self) -> float:
        """A real number, often one that is none."""
        return self.pick(ODD_REALS) if self.flag() else (self.whole(0, 255) - 128) / 16

    def near(self, low: int, high: int) -> int:
        """A number in low..high: usually near the lower end, sometimes at the upper one, sometimes anywhere."""
        kind = self.whole(0, 7)
        if kind < 5:
            return min(low + self.whole(0, 12), high)
        return high if kind == 5 else self.whole(low, high)


def edited(data: bytes, choices: Choices) -> bytes:
    """The bytes with one edit: a bit turned, a byte or a run replaced, cut out, put in or doubled, or the end cut off."""
    at, kind, length = choices.whole(0, max(len(data) - 1, 0)), choices.whole(0, 6), choices.whole(1, 9)
    if kind == 0 and data:
        return data[:at] + bytes([data[at] ^ 1 << choices.whole(0, 7)]) + data[at + 1 :]
    if kind == 1:
        return data[:at] + choices.filled(1) + data[at + 1 :]
    if kind == 2:
        return data[:at] + choices.filled(length) + data[at + length :]
    if kind == 3:
        return data[:at] + data[at + length :]
    if kind == 4:
        return data[:at] + choices.filled(length) + data[at:]
    if kind == 5:
        return data[: at + length] + data[at:]
    return data[:at]
