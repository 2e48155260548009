"""What good conformance vectors claim of fields over texels; claims.py has them all."""

import DracoPy
import numpy as np

from texfcodec.scene.scene import WRAP_NAMES

TEX_COORD = 3  # of Draco's attribute types


def uv_in_texels(case):
    """(UVs in texels float64 [V, 2], size of the image) of every unit over texels."""
    fields = [case.stream.fields[u.field] for u in case.textured]
    return [(u.uv / (1 << f["uv_fraction_bits"]), (f["width"], f["height"])) for u, f in zip(case.textured, fields, strict=True)]


def flat_kind(corner):
    """"point" or "line" where the UVs of a face, int64 [3, 2], are no more."""
    (ux, uy), (vx, vy) = (corner[1:] - corner[0]).tolist()
    return "point" if not np.any(corner != corner[0]) else "line" if ux * vy == uy * vx else None


def wraps(case):
    """(mode of s, mode of t) of every field over texels."""
    return [(WRAP_NAMES[f["wrap_s"]], WRAP_NAMES[f["wrap_t"]]) for f in case.images]


def distances(unit, kind=np.float64):
    """How far the quantised UVs of a unit are from whole numbers, as 5.6.2 reckons, in numbers of a kind."""
    (uv,) = [a["data"] for a in DracoPy.decode(bytes(unit["draco_data"])).attributes if a["attribute_type"] == TEX_COORD]
    steps = np.asarray(uv, kind) * (kind((1 << unit["uv_bits"]) - 1) / kind(unit["uv_range"]))
    return np.abs(steps - np.rint(steps)).ravel().tolist()


# Claim -> predicate of the Case of claims.py and the arguments.
TEXELS = {
    "a field over texels": lambda c: len(c.images) == 1 and not c.grids,
    "two fields over texels": lambda c: len(c.images) == 2,
    "one over voxels": lambda c: len(c.grids) == 1,
    "an image of {} x {}": lambda c, w, h: [(f["width"], f["height"]) for f in c.images] == [(w, h)],
    "wrap {}": lambda c, mode: wraps(c) == [(mode, mode)],
    "wrap {} x {}": lambda c, s, t: wraps(c) == [(s, t)],
    "every texel asked": lambda c: bool(c.images) and all(f["num_keys"] == f["width"] * f["height"] for f in c.images),
    "texels that no face asks": lambda c: any(f["num_keys"] < f["width"] * f["height"] for f in c.images),
    "seams": lambda c: any(len(u.lattice) > len(np.unique(u.lattice, axis=0)) for u in c.textured),
    "UVs beside the image": lambda c: any((texel < 0).any() or (texel > size).any() for texel, size in uv_in_texels(c)),
    "UVs several images beside": lambda c: all((texel < -2 * size[0]).any() and (texel > 3 * size[0]).any()
                                               for texel, size in uv_in_texels(c)),
    "UVs in whole texels": lambda c: [f["uv_fraction_bits"] for f in c.images] == [0],
    "UVs in 1/{} of a texel": lambda c, n: [1 << f["uv_fraction_bits"] for f in c.images] == [n],
    "one by nearly a quarter off": lambda c: any(0.2 < away < 0.25 for u in c.uv_units for away in distances(u)),
    "floats that binary32 has further from their numbers": lambda c: any(
        max(distances(u)) <= 0.25 < max(distances(u, np.float32)) for u in c.uv_units),
    "plain UVs": lambda c: {u["uv_bits"] for u in c.uv_units} == {0},
    "UVs quantised to {} bits": lambda c, n: {u["uv_bits"] for u in c.uv_units} == {n},
    "many of which stand for one number": lambda c: all(1 << u["uv_bits"] > 100 * u["uv_range"] for u in c.uv_units),
    "uv_origin {}": lambda c, n: any(n in u["uv_origin"] for u in c.uv_units),
    "all UVs on {} of texels": lambda c, what: all((texel % 1 == (0.5 if what == "centres" else 0)).all()
                                                                   for texel, _ in uv_in_texels(c)),
    "a face whose UVs are a {}": lambda c, what: any(flat_kind(corner) == what for corner in c.corners),
    "three materials in one field over texels": lambda c: len(c.images) == 1 and not c.grids
        and len({u["material_index"] for u in c.uv_units}) == 3,
}
