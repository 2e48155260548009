"""Makes the conformance vectors: --write rewrites conformance/ (streams, case.json, README.md), --check says what would differ.

Every good stream is decoded by our decoder and by the naive one of tests/naive first; nothing is written where they differ, nor
where a title or a list of clauses promises what is not in the stream (vectors_claims.py).
"""

import argparse
import hashlib
import json
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[1:1] = [str(ROOT), str(ROOT / "conformance"), str(ROOT / "tests")]

import vectors_constant  # noqa: E402
import vectors_filter  # noqa: E402
import vectors_materials  # noqa: E402
import vectors_materials_faulty  # noqa: E402
import vectors_neural  # noqa: E402
import vectors_normals  # noqa: E402
import vectors_planar  # noqa: E402
import vectors_texels  # noqa: E402
import vectors_texels_faulty  # noqa: E402
from decode_texfcodec import arrays  # noqa: E402
from naive import decoder as naive  # noqa: E402
from vectors_claims import Case, unkept  # noqa: E402
from vectors_faulty import faulty  # noqa: E402
from vectors_good import parsed, subset, uncommon  # noqa: E402

from texfcodec.asset.scene import WRAP_NAMES  # noqa: E402
from texfcodec.bitstream.syntax import SUPPORT_TEXELS, SUPPORT_VOXELS  # noqa: E402
from texfcodec.channels import CHANNELS  # noqa: E402
from texfcodec.effects import in_words  # noqa: E402
from texfcodec.errors import TexfError  # noqa: E402

HOME = ROOT / "conformance"
LARGEST = 1 << 16
README = """# Conformance vectors

Small streams with the SHA-256 of everything that is decoded from them (clause 9 of [the specification](../bitstream_spec.md)):

- `subset/`: what the encoder writes every day,
- `uncommon/`: what a decoder meets seldom, and what only another encoder would write,
- `faulty/`: streams that have to be refused, each with a single lie; checksums are right unless they are the lie.

## Testing a decoder

    python conformance/run.py --decoder "<command>"      # any decoder
    python conformance/run.py                            # our own, in this process
    python conformance/run.py --decoder "python tests/naive/decoder.py" subset/k33 faulty/   # another, on some of the cases

The command is called as `<command> IN.texf OUT_DIR [--lod L]` and writes these files into `OUT_DIR`, little endian, without a
header, and no others:

| file | content |
|---|---|
| `geometry.bin` | 64-bit rows (field, material, nine lattice coordinates) of all triangles, canonical as in clause 9 |
| `field{{i}}_keys.bin` | 64-bit Morton keys of field i, ascending |
| `field{{i}}_uv.bin` | only where field i is over texels: 64-bit rows of its triangles with UVs, as in clause 9 |
| `sharp_edges.bin` | only where there is such a unit: one byte, 0 or 1, for every edge, in the order of clause 8.4.2 |
| `field{{i}}_group{{g}}_values.bin` | one byte per component, voxel after voxel or texel after texel, of channel group g |

It exits with 0, or refuses: 3 the stream is invalid, 5 it is not supported, 6 it is over one of the decoder's limits. A stream of
`"expect": "limit"` may be found invalid instead, since limits are the decoder's own. With `--lod L` it decodes L levels less.
The runner compares every array at every listed level of detail; a missing or unexpected file is a failure. It needs Python and
nothing else. It prints one line a case and exits with 0, or with 7 where a case has failed. `tests/test_conformance.py` puts
decoders that are wrong on purpose through it.

`case.json` holds `title`, `clauses`, `features` and, by level of detail, the SHA-256 of every array; in `faulty/`, `expect` and
the `code` of our own decoder's error. What a title and its clauses promise is looked up in the stream (`tools/vectors_claims.py`)
whenever the vectors are made or tested. Everything here but the two programs is made by `python tools/gen_vectors.py --write`;
`--check` makes it again in memory and says what differs.

## Vectors by clause

| clause | decoded | refused |
|---|---|---|
{clauses}

## All vectors

| vector | what it is | bytes |
|---|---|---|
{vectors}
"""


def features(vector):
    """What a good stream contains, read from it."""
    stream = parsed(vector.data)
    header, fields, attributes = stream.header, stream.fields, stream.attributes
    grids = [f for f in fields if f["support"] == SUPPORT_VOXELS]
    return {
        "bytes": len(vector.data), "position_bits": header["position_bits"], "faces": header["num_faces"],
        "materials": header["num_materials"], "geometry_units": header["num_geometry_units"],
        "channel_groups": [" + ".join(CHANNELS[n].name for n in g["group_semantics"]) for g in header["channel_groups"]],
        "effects": in_words(header["effects"]),
        "resolution": [f["resolution"] for f in grids], "voxels": [f["num_keys"] for f in grids],
        "area_threshold": [f["area_threshold"] for f in grids],
        **(texel_features(stream) if len(grids) < len(fields) else {}),
        **(neural_features(stream.joint) if stream.joint else {"qp": [a.get("qp") for a in attributes],
                                                                 "slices": [a.get("NumSlices") for a in attributes]}),
        **({"constant": values} if any(values := [a.get("plane_value") for a in attributes]) else {}),
        **({"filters": [a.get("num_filters") for a in attributes]} if any(a.get("filters") for a in attributes) else {}),
        **({"normals": rules} if (rules := normal_features(stream)) else {}),
        "metadata": stream.metadata is not None, "skipped_units": len(stream.skipped),
    }


def normal_features(stream):
    """Rules of shading normals other than the usual one, and marks of edges."""
    rules = [[m["normal_rule"], m["normal_angle"]] for m in stream.materials]
    marks = {"edges": stream.sharp_edges["num_edges"]} if stream.sharp_edges else {}
    return {"rules": rules, **marks} if any(rule not in ([0, 45], [None, None]) for rule in rules) else {}


def texel_features(stream):
    """What fields over texels contain, and their geometry units."""
    images = [f for f in stream.fields if f["support"] == SUPPORT_TEXELS]
    units = [g for g in stream.geometry if g["Support"] == SUPPORT_TEXELS]
    return {
        "images": [[f["width"], f["height"]] for f in images], "texels": [f["num_keys"] for f in images],
        "wrap": [[WRAP_NAMES[f["wrap_s"]], WRAP_NAMES[f["wrap_t"]]] for f in images],
        "uv_fraction_bits": [f["uv_fraction_bits"] for f in images], "uv_bits": [g["uv_bits"] for g in units],
    }


def neural_features(unit):
    """What a 3DNTC unit contains."""
    return {
        "form": ("resident", "transport")[unit["form"]], "widths": unit["Widths"], "num_features": unit["num_features"],
        "grids": [level["level_resolution"] for level in unit["latent_levels"]],
        "rows": [level["num_latents"] or 1 << level["table_log2"] for level in unit["latent_levels"]],
        "latent_bytes": len(unit["latent_data"]), "network_bytes": len(unit["network_data"]),
    }


def hashes(vector, lod):
    """SHA-256 by array name, agreed on by both decoders."""
    ours, other = arrays(vector.data, lod), naive.arrays(naive.decode(vector.data, lod))
    if ours != other:
        names = [name for name in ours | other if ours.get(name) != other.get(name)]
        raise SystemExit(f"{vector.name}, lod {lod}: the two decoders differ in {', '.join(sorted(names))}")
    return {name: hashlib.sha256(content).hexdigest() for name, content in sorted(ours.items())}


def refuse_empty_promises(vector):
    """Ends the program where a good vector does not hold what its title or clauses say."""
    broken = unkept(Case(vector.title, list(vector.clauses), vector.data, list(vector.lods)))
    if broken:
        raise SystemExit(f"{vector.name}: {'; '.join(broken)}")


def case_of(vector):
    """Content of case.json."""
    case = {"title": vector.title, "clauses": list(vector.clauses)}
    if vector.expect:
        return case | {"features": {"bytes": len(vector.data)}, "expect": vector.expect, "code": vector.code}
    refuse_empty_promises(vector)
    return case | {"features": features(vector), "lods": {str(lod): hashes(vector, lod) for lod in vector.lods}}


def refusal(data):
    """Code of our decoder's error, or what it did instead."""
    try:
        arrays(data)
    except TexfError as error:
        return error.code
    return "no error"


def readme(vectors):
    """Text of conformance/README.md."""
    by_number = lambda clause: [int(part) for part in clause.split(".")]
    rows = []
    for clause in sorted({clause for v in vectors for clause in v.clauses}, key=by_number):
        mine = [v for v in vectors if clause in v.clauses]
        names = lambda refused, mine=mine: ", ".join(v.name.split("/")[1] for v in mine if bool(v.expect) == refused)
        rows.append(f"| {clause} | {names(False)} | {names(True)} |")
    every = [f"| {v.name} | {v.title} | {len(v.data)} |" for v in vectors]
    return README.format(clauses="\n".join(rows), vectors="\n".join(every))


def files_of(vectors):
    """Path below conformance/ -> bytes, of everything that is generated."""
    files = {"README.md": readme(vectors).encode()}
    for vector in vectors:
        if len(vector.data) >= LARGEST:
            raise SystemExit(f"{vector.name} has {len(vector.data)} bytes")
        files[f"{vector.name}/in.texf"] = vector.data
        files[f"{vector.name}/case.json"] = (json.dumps(case_of(vector), indent=1, ensure_ascii=False) + "\n").encode()
    return files


def present():
    """Paths below conformance/ of what was generated before."""
    kinds = [path for kind in ("subset", "uncommon", "faulty") for path in sorted((HOME / kind).glob("*/*"))]
    return {path.relative_to(HOME).as_posix() for path in [HOME / "README.md", *kinds] if path.is_file()}


def differences(files):
    """One line per file that is missing, left over or different."""
    there = present()
    changed = [f"{name}: differs" for name in sorted(there & files.keys()) if (HOME / name).read_bytes() != files[name]]
    missing, left_over = sorted(files.keys() - there), sorted(there - files.keys())
    return changed + [f"{name}: is missing" for name in missing] + [f"{name}: left over" for name in left_over]


def write(files):
    """Replaces all generated files."""
    for kind in ("subset", "uncommon", "faulty"):
        shutil.rmtree(HOME / kind, ignore_errors=True)
    for name, content in files.items():
        (HOME / name).parent.mkdir(parents=True, exist_ok=True)
        (HOME / name).write_bytes(content)


def every_vector():
    """All vectors, in the order of README.md."""
    good = [subset(), vectors_constant.subset(), vectors_neural.subset(), vectors_texels.subset(), vectors_materials.subset(),
            uncommon(), vectors_filter.uncommon(), vectors_constant.uncommon(), vectors_neural.uncommon(),
            vectors_texels.uncommon(), vectors_planar.uncommon(), vectors_materials.uncommon(), vectors_normals.uncommon()]
    bad = [faulty(), vectors_filter.faulty(), vectors_constant.faulty(), vectors_neural.faulty(), vectors_texels_faulty.faulty(),
           vectors_planar.faulty(), vectors_materials_faulty.faulty(), vectors_normals.faulty()]
    return [vector for part in (*good, *bad) for vector in part]


def main():
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    mode = parser.add_mutually_exclusive_group(required=True)
    mode.add_argument("--write", action="store_true", help="rewrite conformance/")
    mode.add_argument("--check", action="store_true", help="exit 7 where conformance/ is not what would be written")
    arguments = parser.parse_args()
    vectors = every_vector()
    files = files_of(vectors)
    found = differences(files)
    print("\n".join([*found, f"{len(vectors)} vectors, {len(found)} files differ"]))
    for vector in vectors:
        if vector.expect and refusal(vector.data) != vector.code:
            print(f"{vector.name}: {refusal(vector.data)} instead of {vector.code}", file=sys.stderr)
    if arguments.write:
        write(files)
    return 7 if found and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
