"""Our own decoder as conformance/run.py asks of any.

    python conformance/decode_texfcodec.py IN.texf OUT_DIR [--lod L] [--queries FILE] [--engine auto|numba|wasm]
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the checkout this file is in, installed or not

from texfcodec import DecodeOptions, decode  # noqa: E402
from texfcodec.errors import TexfError  # noqa: E402

QUERY = np.dtype([("field", "<i8"), ("triangle", "<i8"), ("point", "<f8", 3)])


def geometry_rows(units):
    """Clause 9: int64 [F, 11], one row (field, material, corners) per triangle, canonical and sorted."""
    return _sorted(_rows([(unit, unit.lattice) for unit in units], 3))


def uv_rows(units, number):
    """Clause 9: int64 [F, 17], one row (field, material, corners with UVs) per triangle of a field over texels."""
    return _sorted(_uv_rows(units, number))


def _uv_rows(units, number):
    """The same in the order of the units' faces."""
    return _rows([(unit, np.column_stack([unit.lattice, unit.uv])) for unit in units if unit.field == number], 5)


def _rows(corners, columns):
    """Canonical rows of pairs of a unit and what stands at its vertices, int64 [V, columns]."""
    rows = [np.empty((0, 2 + 3 * columns), np.int64)]
    for unit, vertex in corners:
        turns = [vertex[np.roll(unit.faces, turn, axis=1)].reshape(-1, 3 * columns) for turn in range(3)]
        least = turns[0]
        for turn in turns[1:]:
            least = np.where(_less(turn, least)[:, None], turn, least)
        rows.append(np.column_stack([np.full(len(least), unit.field), np.full(len(least), unit.material), least]))
    return np.concatenate(rows)


def _sorted(rows):
    return rows[np.lexsort(rows.T[::-1])]


def _less(a, b):
    """Which rows of a come before those of b, lexicographically: bool [n]."""
    first = (a != b).argmax(axis=1)[:, None]
    return np.take_along_axis(a, first, 1)[:, 0] < np.take_along_axis(b, first, 1)[:, 0]


def arrays(data, lod=0, threads=0, queries=b"", engine="numba"):
    """Clause 9: {array name: bytes} of a stream, and of the answers to queries, if there are any. Raises TexfError."""
    texf = decode(data, DecodeOptions(lod=lod, threads=threads, engine=engine))
    files = {"geometry": geometry_rows(texf.units).astype("<i8").tobytes()}
    if texf.sharp_edges is not None:
        files["sharp_edges"] = texf.sharp_edges.tobytes()
    if texf.coded_normals is not None:
        files["coded_normals"] = texf.coded_normals.astype("<i2").tobytes()
    for i, field in enumerate(texf.fields):
        files[f"field{i}_keys"] = field.keys.astype("<i8").tobytes()
        if field.over_texels:
            files[f"field{i}_uv"] = uv_rows(texf.units, i).astype("<i8").tobytes()
        for g, group in enumerate(texf.groups):
            if group.channels[0].name in field.planes:
                files[f"field{i}_group{g}_values"] = group.join(field.planes).tobytes()
    return files | (answers(texf, np.frombuffer(queries, QUERY)) if queries else {})


def answers(texf, queries):
    """Clause 8.2: {array name: bytes}, binary64 [M, C] of every group, not a number where a field has no values of it. queries:
    QUERY [M]."""
    field, face = queries["field"].copy(), np.zeros(len(queries), np.int64)
    unknown = field < 0
    if unknown.any():
        face[unknown] = texf.nearest_face(queries["point"][unknown])
        field[unknown] = texf.face_field[face[unknown]]
    out = [np.full((len(queries), group.components), np.nan) for group in texf.groups]
    for i, part in enumerate(texf.fields):
        if part.over_texels:
            own = np.flatnonzero(texf.face_field == i)[np.lexsort(_uv_rows(texf.units, i).T[::-1])]
            named = (field == i) & ~unknown
            face[named] = own[queries["triangle"][named]]
        chosen, known = np.flatnonzero(field == i), [c.name for c in texf.channels if c.name in part.planes]
        planes = texf.query_planes(i, known, queries["point"][chosen], face[chosen]) if len(chosen) else {}
        for g, group in enumerate(texf.groups):
            if group.channels[0].name in planes:
                out[g][chosen] = group.join(planes)
    return {f"group{g}_answers": values.astype("<f8").tobytes() for g, values in enumerate(out)}


def main():
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stream", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lod", type=int, default=0)
    parser.add_argument("--queries", type=Path)
    parser.add_argument("--engine", default="numba")
    arguments = parser.parse_args()
    try:
        queries = arguments.queries.read_bytes() if arguments.queries else b""
        files = arrays(arguments.stream.read_bytes(), arguments.lod, queries=queries, engine=arguments.engine)
    except TexfError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (arguments.folder / f"{name}.bin").write_bytes(content)
    return 0


if __name__ == "__main__":
    sys.exit(main())
