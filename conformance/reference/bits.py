"""Clauses 4.3, 5.1 and 5.2 in plain Python: descriptors, framing, CRC. Written from bitstream_spec.md alone."""

import math
import struct
import zlib

MAGIC = bytes.fromhex("895458460D0A1A0A")
ONE_AT_MOST, END, ANCILLARY = (0, 1, 128, 129, 130), 5, 128  # unit types


class Invalid(Exception):
    """The stream breaks a rule of clauses 4 to 7."""


class Unsupported(Exception):
    """The stream may be right, but this decoder does not know what it asks for."""


def require(condition, sentence):
    """Raise Invalid with the sentence unless the condition holds."""
    if not condition:
        raise Invalid(sentence)


def known(name, value, high):
    """A value of a registry (4.3)."""
    if value > high:
        raise Unsupported(f"{name} is {value}")
    return value


class Reader:
    """Reads the descriptors of 4.3, one after the other, from a run of bytes."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count, name):
        require(count <= len(self.data) - self.at, f"{name}: {count} bytes wanted, {len(self.data) - self.at} left")
        self.at += count
        return self.data[self.at - count : self.at]

    def rest(self):
        return self.take(len(self.data) - self.at, "rest")

    def ended(self):
        return self.at == len(self.data)

    def count_of(self, name, count, least):
        """A count of elements of at least so many bytes each, all of which the bytes that are left have to hold (4.3)."""
        require(count * least <= len(self.data) - self.at, f"{name}: {count} of at least {least} bytes do not fit")
        return count

    def number(self, size, name, low, high, signed=False):
        value = int.from_bytes(self.take(size, name), "little", signed=signed)
        require(low <= value <= high, f"{name} is {value}, not in {low}..{high}")
        return value

    def u8(self, name, low=0, high=255):
        return self.number(1, name, low, high)

    def u16(self, name, low=0, high=65535):
        return self.number(2, name, low, high)

    def u32(self, name):
        return self.number(4, name, 0, 2**32 - 1)

    def i8(self, name):
        return self.number(1, name, -128, 127, signed=True)

    def i32(self, name, low, high):
        return self.number(4, name, low, high, signed=True)

    def f64(self, name, low=-1e300):
        (value,) = struct.unpack("<d", self.take(8, name))
        require(math.isfinite(value) and low <= value <= 1e300, f"{name} is {value}")
        return value

    def f32(self, name):
        (value,) = struct.unpack("<f", self.take(4, name))
        require(math.isfinite(value), f"{name} is {value}")
        return value

    def v(self, name, low=0, high=2**56 - 1):
        value = 0
        for i in range(8):
            byte = self.u8(name)
            value += (byte & 127) << (7 * i)
            if byte < 128:
                require(byte > 0 or i == 0, f"{name} is not in its shortest form")
                require(low <= value <= high, f"{name} is {value}, not in {low}..{high}")
                return value
        raise Invalid(f"{name} has more than 8 bytes")

    def utf8(self, count, name):
        try:
            return self.take(count, name).decode("utf-8")
        except UnicodeDecodeError as error:
            raise Invalid(f"{name} is not UTF-8") from error


def units_of(data):
    """Steps 1 to 3 of 9.2: the list of (type, payload) of a stream."""
    require(data[:8] == MAGIC, "the stream does not begin with the eight bytes of 5.1")
    reader, units = Reader(data), []
    reader.take(8, "magic")
    while not units or units[-1][0] != END:
        start = reader.at
        unit_type = reader.u8("unit_type")
        payload = reader.take(reader.v("unit_length"), "payload")
        crc = zlib.crc32(data[start : reader.at])
        require(reader.u32("unit_crc") == crc, f"the checksum of unit {len(units)} (type {unit_type}) does not match")
        check_place(unit_type, payload, {before for before, _ in units})
        units.append((unit_type, payload))
    require(units[-1][1] == b"", "the end unit has a payload")
    require(reader.ended(), "bytes follow the end unit")
    return units


def check_place(unit_type, payload, before):
    """Clause 5.2: whether a unit may stand behind those of the types before it; of the first one, the version."""
    if not before:
        require(unit_type == 0, "the first unit is no sequence header")
        require(payload, "the sequence header is empty")
        if payload[0] != 1:
            raise Unsupported(f"version {payload[0]}")
    require(unit_type not in ONE_AT_MOST or unit_type not in before, f"a second unit of type {unit_type}")
    if END < unit_type < ANCILLARY:
        raise Unsupported(f"critical unit of type {unit_type}")
    require(unit_type > END or all(unit_type >= other or other > END for other in before), "units are out of order")
