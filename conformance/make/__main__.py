"""Makes the conformance vectors: --write rewrites conformance/ (streams, case.json, queries.json, tables of README.md), --check
says what would differ. --module and --only make a part of them and leave the others as they stand.

Every good stream is decoded by our decoder and by the reference one first; nothing is written where they differ, nor
where a claim or a clause of a vector is not in its stream (claims.py).
"""

import argparse
import hashlib
import json
import re
import shutil
import sys
from importlib import import_module
from pathlib import Path

from decode_texfcodec import arrays

from conformance.make.claims import Case, unkept
from conformance.make.good import parsed
from conformance.make.levels import level_checks
from conformance.make.promise import changed
from conformance.make.queries import queries_file
from conformance.make.spec_tables import with_block
from conformance.make.vector import Vector, faulty, good
from conformance.reference import decoder as naive
from texfcodec.bitstream.syntax import SUPPORT_TEXELS, SUPPORT_VOXELS
from texfcodec.errors import TexfError
from texfcodec.scene.channels import CHANNELS
from texfcodec.scene.scene import WRAP_NAMES

HOME = Path(__file__).resolve().parents[1]
LARGEST = 1 << 16
# Modules that make vectors, in the order of README.md.
MAKERS = {"subset": ("good", "constant", "neural", "texels", "materials"),
          "uncommon": ("good", "filter", "constant", "neural", "texels", "planar", "materials", "normals", "rules",
                       "misread", "readings"),
          "faulty": ("faulty", "filter", "constant", "neural", "texels_faulty", "planar", "materials_faulty", "normals",
                     "order", "misread_faulty", "readings")}


def features(vector):
    """What a good stream contains, read from it."""
    stream = parsed(vector.data)
    header, fields, attributes = stream.header, stream.fields, stream.attributes
    grids = [f for f in fields if f["support"] == SUPPORT_VOXELS]
    return {
        "bytes": len(vector.data), "position_bits": header["position_bits"], "faces": stream.faces,
        "materials": header["num_materials"], "geometry_units": header["num_geometry_units"],
        "channel_groups": [" + ".join(CHANNELS[n].name for n in g["group_semantics"]) for g in header["channel_groups"]],
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
    """Ends the program where a good vector does not hold what its claims and clauses say."""
    broken = unkept(Case(vector.claims, vector.clauses, vector.data, vector.lods))
    if broken:
        raise SystemExit(f"{vector.name}: {'; '.join(broken)}")


def case_of(vector):
    """Content of case.json."""
    case = {"title": vector.title, "clauses": list(vector.clauses)}
    if vector.expect:
        return case | {"features": {"bytes": len(vector.data)}, "expect": vector.expect, "code": vector.code}
    refuse_empty_promises(vector)
    levels = level_checks(vector.data)
    lods = {str(lod): hashes(vector, lod) for lod in vector.lods}
    return case | {"claims": vector.claims, "features": features(vector), "lods": lods, **({"levels": levels} if levels else {})}


def refusal(data):
    """Code of our decoder's error, or what it did instead."""
    try:
        arrays(data)
    except TexfError as error:
        return error.code
    return "no error"


def readme(vectors, files):
    """Text of conformance/README.md with its tables renewed."""
    by_number = lambda clause: [int(part) for part in clause.split(".")]
    clauses = ["| clause | decoded | refused |", "|---|---|---|"]
    for clause in sorted({clause for v in vectors for clause in v.clauses}, key=by_number):
        of_clause = [v for v in vectors if clause in v.clauses]
        names = lambda refused, own=of_clause: ", ".join(v.name.split("/")[1] for v in own if bool(v.expect) == refused)
        clauses.append(f"| {clause} | {names(False)} | {names(True)} |")
    query_count = lambda v: sum(map(len, json.loads(files.get(f"{v.name}/queries.json", '{"lods": {}}'))["lods"].values())) or ""
    every = ["| vector | what it is | bytes | queries |", "|---|---|---|---|",
             *(f"| {v.name} | {v.title} | {len(v.data)} | {query_count(v)} |" for v in vectors)]
    text = (HOME / "README.md").read_text(encoding="utf-8")
    return with_block(with_block(text, "by clause", "\n".join(clauses), "README.md"), "all", "\n".join(every), "README.md")


def written_files(vector):
    """File name -> bytes, of one vector."""
    if len(vector.data) >= LARGEST:
        raise SystemExit(f"{vector.name} has {len(vector.data)} bytes")
    case, queries = case_of(vector), queries_file(vector)
    files = {"in.texf": vector.data, "case.json": (json.dumps(case, indent=1, ensure_ascii=False) + "\n").encode()}
    return files | ({"queries.json": queries} if queries else {})


def files_of(vectors, chosen):
    """Path below conformance/ -> bytes, of everything that is generated; of vectors that are not chosen, as they stand."""
    files = {}
    for vector in vectors:
        stands = {path.name: path.read_bytes() for path in sorted((HOME / vector.name).glob("*"))}
        contents = written_files(vector) if vector in chosen else stands
        files |= {f"{vector.name}/{name}": content for name, content in contents.items()}
    return {"README.md": readme(vectors, files).encode()} | files


def standing():
    """The vectors of conformance/, in the order of README.md."""
    out = []
    for name in re.findall(r"^\| ((?:subset|uncommon|faulty)/\w+) \|", (HOME / "README.md").read_text(encoding="utf-8"), re.M):
        case, data = json.loads((HOME / name / "case.json").read_text(encoding="utf-8")), (HOME / name / "in.texf").read_bytes()
        lods = tuple(map(int, case.get("lods", {"0": None})))
        how, claims = (case.get("expect", ""), case.get("code", "")), tuple(case.get("claims", ()))
        out.append(Vector(name, case["title"], tuple(case["clauses"]), data, lods, *how, claims))
    return out


def put_in(vectors, new):
    """Puts new vectors into the places of those of their names, or behind the last of their kind."""
    for vector in new:
        names = [other.name for other in vectors]
        if vector.name in names:
            vectors[names.index(vector.name)] = vector
        else:
            kind = vector.name.split("/")[0]
            vectors.insert(1 + max(i for i, name in enumerate(names) if name.startswith(kind)), vector)


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


def vectors_made(module=None):
    """All vectors, in the order of README.md, or those of one module."""
    out = []
    for kind, makers in MAKERS.items():
        for maker in makers if module is None else [name for name in makers if name == module]:
            rows = getattr(import_module(f"conformance.make.{maker}"), kind)()
            out += [faulty(*row) if kind == "faulty" else good(kind, *row) for row in rows]
    return out


def main():
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    mode = parser.add_mutually_exclusive_group(required=True)
    mode.add_argument("--write", action="store_true", help="rewrite conformance/")
    mode.add_argument("--check", action="store_true", help="exit 7 where conformance/ is not what would be written")
    parser.add_argument("--module", metavar="NAME", help="make the vectors of this module, such as rules")
    parser.add_argument("--only", metavar="PART", help="ask the streams that stand there, of whose names this is a part, anew")
    arguments = parser.parse_args()
    if arguments.module or arguments.only:
        vectors, chosen = standing(), vectors_made(arguments.module) if arguments.module else []
        put_in(vectors, chosen)
        chosen += [vector for vector in vectors if arguments.only and arguments.only in vector.name and vector not in chosen]
    else:
        vectors = chosen = vectors_made()
    files = files_of(vectors, chosen)
    differing = differences(files)
    print("\n".join([*differing, f"{len(vectors)} vectors, {len(chosen)} made anew, {len(differing)} files differ"]))
    for vector in chosen:
        if vector.expect and refusal(vector.data) != vector.code:
            print(f"{vector.name}: {refusal(vector.data)} instead of {vector.code}", file=sys.stderr)
    if arguments.write:
        if broken := changed({vector.name: vector.data for vector in chosen}):
            raise SystemExit(f"nothing is written: {', '.join(broken)} would break a promise; give the new streams new names")
        write(files)
    return 7 if differing and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
