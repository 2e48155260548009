"""Streams of two faults each, and what 9.2 calls them: invalid or unsupported, by the fault whose step and place come first.

    python -m conformance.make.double_faults [--decoder "<command>"] [--share N]

puts a decoder through every N-th of them, ours without a command, and prints by steps how many it refuses rightly; exits 0 or 7.
"""

import argparse
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

from conformance import run as runner
from texfcodec import Limits
from texfcodec.bitstream.stream import read_stream
from texfcodec.bitstream.syntax import SIGNATURE, UNIT_ATTRIBUTE, UNIT_END, UNIT_FIELD, UNIT_GEOMETRY, UNIT_MATERIALS
from texfcodec.core.syntax_walk import write_v

BASES = ("uncommon/maps_parameters", "uncommon/queries_sheets", "subset/texels_alpha", "uncommon/normals_coded_sharp",
         "uncommon/neural_two_fields")
SHARE = 29
INVALID, UNSUPPORTED = 3, 5  # exit codes
ALL = 1 << 30
# Order in a payload: elements; of an attribute unit then what it names, codec, level_shift, parameters; rules; the payload's end.
RANKS = ("ELEMENT", "NAME", "CODEC", "SHIFT", "PARAMETER", "RULE", "COMPONENTS", "END")
HEAD = ("field_index", "group_index", "codec_id", "level_shift", "values_crc")
# By unit type: element, its first bytes instead, S (invalid) or U (unsupported), and where it is refused if not at the element:
# a step of 9.2, or a rank in step 4. An index of -1 is the last one.
PATCHES = {
    0: """version 02 U 2, position_bits 07 S, side 000000000000f0bf S, num_geometry_units 7f S 5, num_channel_groups 18 U,
        num_channel_groups 17 S, channel_groups[0].num_semantics 00 S, channel_groups[-1].num_semantics 03 S,
        channel_groups[0].group_semantics 17 U, channel_groups[1].group_semantics 00 S RULE,
        channel_groups[0].group_components 02 U COMPONENTS, channel_groups[-1].group_components 04 S""",
    1: """materials[0].material_name ff S, materials[0].alpha_mode 03 U, materials[-1].material_flags 04 U,
        materials[0].normal_rule 07 U, materials[-1].normal_angle b5 S, materials[0].material_channels 02 S RULE,
        materials[0].material_channels 10 S 5, materials[-1].num_parameters 1c U, materials[-1].num_parameters 1b S,
        materials[1].parameters[0].parameter_id 1b U, materials[0].parameters[0].parameter_value 0000803f S RULE,
        materials[0].parameters[1].parameter_value 0000c07f S""",
    2: """field_index 05 S 5, support 02 U, resolution 0000 S, width 0000 S, wrap_s 03 U, wrap_t ff U, uv_fraction_bits 09 S,
        num_keys 00 S, keys_crc 01020304 S 7""",
    3: """field_index 7f S 5, material_index 7f S 5, unit_vertices 02 S, unit_faces 00 S, uv_bits 15 S,
        geometry_crc 01020304 S 6""",
    4: """field_index 7f S NAME, group_index 17 S, group_index 16 S NAME, codec_id 07 U CODEC, level_shift 0e S,
        level_shift 0d S SHIFT, values_crc 01020304 S 7, colour_transform 02 U, kernel 00 S RULE, num_models 09 S,
        planar_transform 02 U, num_filters 04 S, residual 81 S, slice_level 0d S, level_index 02 S, form 02 U, wave_octaves 09 S,
        num_hidden 00 S""",
    129: "num_edges 00 S, marks_crc 01020304 S 6",
    130: "num_groups 00 S, normal_step 0000 S, normals_crc 01020304 S 6",
}


@dataclass(eq=False)
class Unit:
    """A unit that may be spoiled. places: (offset, size) by element; crc: what its checksum is changed by."""

    kind: int
    payload: bytearray
    places: dict = field(default_factory=dict)
    crc: int = 0

    def packed(self) -> bytes:
        """Return the unit's bytes."""
        body = bytes([self.kind]) + write_v(len(self.payload)) + self.payload
        return body + (zlib.crc32(body) ^ self.crc).to_bytes(4, "little")

    def element(self, name: str) -> str:
        """Return the name of an element with an index in the place of [-1]."""
        array, last, rest = name.partition("[-1]")
        indices = [int(place[len(array) + 1 :].split("]")[0]) for place in self.places if place.startswith(f"{array}[")]
        return f"{array}[{max(indices, default=0)}]{rest}" if last else name


@dataclass
class Fault:
    """expect: exit code; step of 9.2 and rank among the faults of a unit; at: number of the unit that is spoiled, and the range
    of bytes in its payload; edit: called with (all units, that unit), returns the unit that is refused."""

    title: str
    expect: int
    step: int
    rank: tuple
    at: tuple
    edit: Callable


def placed_units(data: bytes) -> list[Unit]:
    """Return the units of a valid stream."""
    trace: list = []
    read_stream(data, Limits(), trace)
    units = [Unit(unit.type, bytearray(data[unit.begin : unit.end]), {row[0]: (row[1] - unit.begin, row[2]) for row in rows})
             for unit, rows in trace]
    return [*units, Unit(UNIT_END, bytearray())]


def _patches(unit, number):
    """The faults of PATCHES in a unit."""
    for row in filter(None, PATCHES.get(unit.kind, "").split(",")):
        name, digits, letter, *where = row.split()
        name, raw = unit.element(name), bytes.fromhex(digits)
        offset, size = unit.places.get(name, (0, 0))
        if size < len(raw):
            continue

        def edit(_, unit, raw=raw, offset=offset):
            unit.payload[offset : offset + len(raw)] = raw
            return unit

        in_order = "PARAMETER" if unit.kind == UNIT_ATTRIBUTE and name not in HEAD else "ELEMENT"
        step = int(where[0]) if where and where[0].isdigit() else 4
        rank = (RANKS.index(where[0]), 0) if where and step == 4 else (RANKS.index(in_order), offset)
        yield Fault(f"{name} {digits}", UNSUPPORTED if letter == "U" else INVALID, step, rank if step == 4 else (3,),
                    (number, offset, offset + len(raw)), edit)


def _frames(unit, number):
    """The faults of a unit's frame, place and end."""
    size = len(unit.payload)
    before, behind, whole = (number, 0, 0), (number, size, size + 1), (number, 0, ALL)
    spoil = lambda **changes: lambda _, unit: (vars(unit).update(changes), unit)[1]
    left_over = lambda _, unit: (unit.payload.extend(b"\0"), unit)[1]
    end = (RANKS.index("END"),)
    yield Fault(f"crc of unit {number}", INVALID, 3 if number else 2, (1,), whole, spoil(crc=1))
    if number == 0:
        yield Fault("first unit of type 200", INVALID, 2, (2,), whole, spoil(kind=200))
        yield Fault("empty header", INVALID, 2, (3,), whole, spoil(payload=bytearray()))
        yield Fault("signature", INVALID, 1, (), before, lambda *_: None)
        yield Fault("header with a byte left over", INVALID, 4, end, behind, left_over)
        return
    yield Fault(f"reserved unit before {number}", UNSUPPORTED, 3, (3,), before, _inserted(6))
    yield Fault(f"reserved unit with a wrong crc before {number}", INVALID, 3, (1,), before, _inserted(6, crc=1))
    yield Fault(f"second header before {number}", INVALID, 3, (2,), before, _inserted(0))
    yield Fault(f"empty metadata before {number}", INVALID, 4, (0, 0), before, _inserted(128))
    if unit.kind == UNIT_END:
        yield Fault("payload of the end unit", INVALID, 3, (5,), whole, left_over)
    if unit.kind in (UNIT_MATERIALS, UNIT_FIELD):
        yield Fault(f"unit {number} with a byte left over", INVALID, 4, end, behind, left_over)
        yield Fault(f"unit {number} at the end", INVALID, 3, (4,), whole, _moved)
    if unit.kind == UNIT_GEOMETRY:
        cut = bytearray(b"\x7f" + unit.payload[1 : sum(unit.places["unit_faces"])])
        yield Fault(f"unit {number} of no field, cut behind unit_faces", INVALID, 5, (), whole, spoil(payload=cut))
    if unit.kind in (UNIT_MATERIALS, UNIT_ATTRIBUTE, 129, 130):
        yield Fault(f"no unit {number}", INVALID, 5, (), whole, lambda units, unit: units.remove(unit))


def _inserted(kind, crc=0):
    def edit(units, unit):
        new = Unit(kind, bytearray(), crc=crc)
        units.insert(units.index(unit), new)
        return new
    return edit


def _moved(units, unit):
    """Moves a unit to the end, where it stands out of order."""
    units.remove(unit)
    units.insert(-1, unit)
    return unit


def faults_of(data: bytes) -> list[Fault]:
    """Return all faults of a stream, each by itself."""
    return [fault for number, unit in enumerate(placed_units(data))
            for fault in (*_frames(unit, number), *_patches(unit, number))]


def spoiled(data: bytes, *faults: Fault) -> tuple[bytes, int]:
    """Return (stream, exit code) of a stream with some faults."""
    original = placed_units(data)
    units, places = list(original), []
    for fault in sorted(faults, key=lambda fault: fault.at[2]):  # units go and move last
        places.append((fault, fault.edit(units, original[fault.at[0]])))
    key = lambda place: (place[0].step, units.index(place[1]) if 2 <= place[0].step <= 4 else 0, place[0].rank)
    head = b"\x89TXG" + SIGNATURE[4:] if any(fault.step == 1 for fault in faults) else SIGNATURE
    return head + b"".join(unit.packed() for unit in units), min(places, key=key)[0].expect


def double_faults(share: int = 1):
    """Yield (title, stream, exit code, steps) of every share-th pair of faults that do not change the same bytes."""
    clash = lambda a, b: a.at[0] == b.at[0] and a.at[1] < b.at[2] and b.at[1] < a.at[2]
    for base in BASES:
        data = (runner.HERE / base / "in.texf").read_bytes()
        for a, b in [pair for pair in combinations(faults_of(data), 2) if not clash(*pair)][::share]:
            yield f"{base}: {a.title}, {b.title}", *spoiled(data, a, b), tuple(sorted((a.step, b.step)))


def main() -> int:
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--decoder", help="command, called as <command> IN.texf OUT_DIR; default: our own")
    parser.add_argument("--share", type=int, default=1, metavar="N", help="put every N-th pair (default: all)")
    arguments = parser.parse_args()
    sys.path.append(str(runner.HERE))  # where ours is
    decoder = runner.CommandDecoder(arguments.decoder, 600) if arguments.decoder else runner.OwnDecoder()
    pairs, wrong = Counter(), Counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "in.texf"
        for title, data, expect, steps in double_faults(arguments.share):
            path.write_bytes(data)
            exit_code, _, said = decoder(path, 0)
            pairs[steps] += 1
            if exit_code != expect:
                wrong[steps] += 1
                print(f"FAIL {title}: exit code {exit_code}, expected {expect}: {said}")
    for (a, b), count in sorted(pairs.items()):
        print(f"steps {a} and {b}: {count - wrong[a, b]} of {count}")
    print(f"{pairs.total() - wrong.total()} of {pairs.total()} pairs")
    return 7 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
