"""The faulty conformance vectors of fields over texels (clauses 5.5, 5.6, 5.7, 6.5.4 and 10)."""

from unittest.mock import patch

import DracoPy
import numpy as np

from conformance.make import neural
from conformance.make.faulty import F, G, allowing, with_element, with_right_crc, with_units, with_values
from conformance.make.good import parsed
from conformance.make.rules import beginning_at
from conformance.make.texels import CLAMPED, Grid, Image, Patch, far, off_by, picture, quantised, ring, sheet, stream_of_parts
from texfcodec.bitstream.syntax import GEOMETRY
from texfcodec.core.syntax_walk import write_v
from texfcodec.geometry import draco
from texfcodec.geometry.draco import counts_of

SIZE = (20, 12)


def base_stream():
    """A field over texels, plain UVs; not every texel is asked."""
    return stream_of_parts([Image(picture(*SIZE), CLAMPED)], [ring(SIZE, 4, (0.5, 0.4), (2, 3))])


def quantised_stream():
    """The same with UVs quantised to eight bits."""
    return stream_of_parts([Image(picture(*SIZE), CLAMPED)], [quantised(ring(SIZE, 4, (0.5, 0.4), (2, 3)), 8)])


def reaching_256():
    """UVs of 0 to 256 quantised to eight bits, for which eight bits are one too few."""
    uv = [(0, 0), (256, 8), (190, 100), (0, 0), (190, 100), (9, 112)]
    return stream_of_parts([Image(picture(*SIZE), CLAMPED)], [quantised(sheet(uv), 8)])


def reaching_2_20():
    """A stream in order but for a UV that is 2^20 more than uv_origin."""
    uv = [(0, 0), (1 << 20, 8), (190, 100), (0, 0), (190, 100), (9, 112)]
    with patch.object(draco, "MAX_UV_BITS", 21):
        return stream_of_parts([Image(picture(*SIZE), CLAMPED, 8)], [sheet(uv)])


def beginning_beyond(sign):
    """A stream in order but for a uv_origin of 2^25 or -2^25."""
    with allowing(GEOMETRY, "uv_origin", low=-(1 << 25), high=1 << 25):
        return far(sign, 1 << 25)


def one_step_off(step):
    """UVs in eight bits whose floats are a step less or more than they may be; uv_origin makes up for it, so that they are the
    same UVs."""
    data = stream_of_parts([Image(picture(9, 7))], [sheet([(0, 0), (255, 7), (250, 200), (0, 0), (250, 200), (3, 255)], bits=8)])
    moved = with_values(data, lambda stream: stream.geometry[0].update(uv_origin=[-step, 0]))
    return beginning_at(moved, (step, 0))


def off_by_more():
    """UVs of which one is a little more than a quarter from its whole number."""
    return _with_draco(stream_of_parts([Image(picture(14, 8), CLAMPED)], [off_by(0.99)]), off_by(1.01).textured()[0])


def fields():
    """Clauses 5.5, 6.5.4 and 10."""
    base = base_stream()
    constant = stream_of_parts([Image(picture(*SIZE), CLAMPED, constant=True)], [ring(SIZE, 4, (0.5, 0.4), (2, 3))])
    keys = parsed(base).fields[0]["num_keys"]
    above = stream_of_parts([Image(picture(*SIZE))], [ring(SIZE, 4, (1, 0.3), (0, -2))])
    u16 = lambda value: value.to_bytes(2, "little")

    def add(name, title, element, raw, code="TXF-S04"):
        return name, title, "6.5.4" if code == "TXF-S30" else "5.5", with_element(base, F, element, raw), code

    lines = [
        add("support_2", "support 2", "support", b"\2", "TXF-U09"),
        add("texels_wrap_s_3", "wrap_s 3", "wrap_s", b"\3", "TXF-U09"),
        add("texels_wrap_t_255", "wrap_t 255", "wrap_t", b"\xff", "TXF-U09"),
        add("texels_fraction_9", "uv_fraction_bits 9", "uv_fraction_bits", b"\x09"),
        add("texels_width_0", "width 0", "width", u16(0)),
        add("texels_height_0", "height 0", "height", u16(0)),
        ("texels_width_16385", "width 16385", "5.5", with_element(constant, F, "width", u16(16385)), "TXF-S04"),
        add("texels_height_65535", "height 65535", "height", u16(65535)),
        add("texels_num_keys_over", "num_keys is more than the image has texels", "num_keys", write_v(SIZE[0] * SIZE[1] + 1)),
        add("texels_num_keys_0", "num_keys is 0", "num_keys", b"\0"),
        add("texels_num_keys", "num_keys is one too many", "num_keys", write_v(keys + 1), "TXF-S30"),
        add("texels_num_keys_less", "num_keys is one too few", "num_keys", write_v(keys - 1), "TXF-S30"),
        add("texels_keys_crc", "a wrong keys_crc over texels", "keys_crc", b"\1\2\3\4", "TXF-S30"),
        add("texels_width", "another width than the texels were made for", "width", u16(9), "TXF-S30"),
        add("texels_fraction", "other uv_fraction_bits than the texels were made for", "uv_fraction_bits", b"\5", "TXF-S30"),
        ("texels_wrap", "another wrap_t than the texels were made for", "6.5.4",
         with_element(above, F, "wrap_t", b"\1"), "TXF-S30"),
        ("texels_cut", "a field unit that ends after height", "5.5", with_units(base, lambda units: _cut(units, F, 6)),
         "TXF-S02"),
        ("texels_as_voxels", "support 0 before the elements of texels", "5.5", with_element(base, F, "support", b"\0"),
         "TXF-S08"),
    ]
    beside = stream_of_parts([Image(picture(*SIZE))], [ring(SIZE, shift=(-3, -2))])
    huge = with_values(beside, lambda stream: stream.fields[0].update(width=16384, height=16384))
    limit = [("texels_num_keys_huge", "2^28 texels", "10", with_element(base, F, "num_keys", write_v(1 << 28)), "TXF-L04"),
             ("texels_image_huge", "an image of 2^28 texels", "10", huge, "TXF-L11")]
    return [*lines, *limit]


def _cut(units, kind, size):
    """Cuts the first unit of a type off after so many bytes."""
    at = next(i for i, (other, _) in enumerate(units) if other == kind)
    units[at] = (kind, units[at][1][:size])


def uv_attributes():
    """Clause 5.6: Draco substreams whose attributes are not those that the unit says."""
    base, coarse = base_stream(), quantised_stream()
    mesh = DracoPy.decode(bytes(parsed(base).geometry[0]["draco_data"]))
    points, faces = np.asarray(mesh.points), np.asarray(mesh.faces)
    uv = next(np.asarray(a["data"]) for a in mesh.attributes if len(a["data"][0]) == 2)
    coded = lambda **more: DracoPy.encode(points, faces, compression_level=10, create_metadata=False, **more)
    plain = lambda values: _with_draco(base, coded(generic_attributes={1: values}))
    floats = _with_draco(base, coded(tex_coord=uv.astype(np.float64), tex_coord_quantization_bits=8))
    colours = np.full((len(points), 3), 9, np.uint8)
    lines = [
        ("texels_without_uv", "Draco data without UVs", _with_draco(base, coded()), "TXF-S20"),
        ("texels_uv_floats", "quantised UVs where uv_bits is 0", floats, "TXF-S20"),
        ("texels_uv_plain", "plain UVs where uv_bits is 8", _with_draco(coarse, coded(generic_attributes={1: uv})), "TXF-S20"),
        ("texels_uv_generic", "plain UVs that are floats", plain(uv.astype(np.float32)), "TXF-S20"),
        ("texels_uv_16", "UVs of 16-bit integers", plain(uv.astype(np.uint16)), "TXF-S20"),
        ("texels_uv_three", "UVs of three numbers", plain(np.column_stack([uv, uv[:, :1]])), "TXF-S20"),
        ("texels_uv_colours", "colours beside the UVs",
         _with_draco(base, coded(generic_attributes={1: uv}, colors=colours)), "TXF-S20"),
        ("texels_uv_large", "a UV of 2^20", reaching_2_20(), "TXF-S23"),
    ]
    around = ring((9, 6))
    voxels = stream_of_parts([Grid(6)], [Patch(around.lattice, around.faces)])
    over_voxels = ("voxels_with_uv", "UVs in a unit of a field over voxels", "5.6.1",
                   _with_draco(voxels, around.values(True)["draco_data"]), "TXF-S20")
    return [*((name, title, "5.6.2", data, code) for name, title, data, code in lines), over_voxels]


def _with_draco(data, substream):
    """The stream with another Draco substream in its unit, and the counts that this names."""

    def edit(stream):
        (unit,) = stream.geometry
        unit["draco_data"] = substream
        unit["unit_vertices"], unit["unit_faces"] = counts_of(substream)

    return with_values(data, edit)


def uv_elements():
    """Clause 5.6: elements of the geometry unit."""
    base, coarse = base_stream(), quantised_stream()
    lies = lambda **changes: with_values(coarse, lambda stream: stream.geometry[0].update(changes))
    (x, y), reach = parsed(base).geometry[0]["uv_origin"], parsed(coarse).geometry[0]["uv_range"]
    origin = lambda *values: with_element(base, G, "uv_origin", b"".join(v.to_bytes(4, "little", signed=True) for v in values))
    wide = with_element(with_element(coarse, G, "uv_bits", b"\x14"), G, "uv_range", write_v(1 << 20))
    vertices = parsed(base).geometry[0]["unit_vertices"]
    lines = [
        ("texels_uv_vertices", "unit_vertices is one less than Draco's own count",
         with_element(base, G, "unit_vertices", write_v(vertices - 1)), "TXF-S21"),
        ("texels_uv_range_less", "uv_range less than the UVs reach", lies(uv_range=reach - 40), "TXF-S23"),
        ("texels_uv_range_more", "a uv_range that the UVs were not quantised for", lies(uv_range=reach + 5), "TXF-S23"),
        ("texels_uv_minus_one", "a UV that is step -1 of its quantisation", one_step_off(-1), "TXF-S23"),
        ("texels_uv_last_and_one", "a UV that is step 2^uv_bits of its quantisation", one_step_off(1), "TXF-S23"),
        ("texels_uv_far", "a UV that is by hardly more than a quarter off", off_by_more(), "TXF-S23"),
        ("texels_uv_bits_7", "fewer uv_bits than the UVs were quantised to", lies(uv_bits=7, uv_range=127), "TXF-S23"),
        ("texels_uv_range_over", "uv_range 256 with eight bits", reaching_256(), "TXF-S04"),
        ("texels_uv_range_0", "uv_range 0", with_element(coarse, G, "uv_range", b"\0"), "TXF-S04"),
        ("texels_uv_range_2_20", "uv_range 2^20", wide, "TXF-S04"),
        ("texels_uv_bits_21", "uv_bits 21", with_element(coarse, G, "uv_bits", b"\x15"), "TXF-S04"),
        ("texels_uv_origin", "uv_origin 2^25", beginning_beyond(1), "TXF-S04"),
        ("texels_uv_origin_low", "uv_origin -2^25", beginning_beyond(-1), "TXF-S04"),
        ("texels_geometry_cut", "a geometry unit that ends in uv_origin", with_units(base, lambda units: _cut(units, G, 9)),
         "TXF-S02"),
    ]
    others = [
        ("texels_uv_crc", "another uv_origin than geometry_crc was made for", "5.6.3", origin(x + 64, y), "TXF-S24"),
        ("texels_uv_moved", "another uv_origin than the texels were made for", "6.5.4", with_right_crc(origin(x + 64, y)),
         "TXF-S30"),
    ]
    return [*((name, title, "5.6.2", data, code) for name, title, data, code in lines), *others]


def neural_over_texels():
    """A 3DNTC unit, in order but for the field that it stands beside."""
    textured = parsed(base_stream())

    def edit(stream):
        stream.fields, stream.geometry, stream.materials = textured.fields, textured.geometry, textured.materials
        stream.header.update({name: textured.header[name] for name in (
            "position_bits", "num_materials", "num_fields", "num_geometry_units")})

    small = next(data for name, _, _, data, *_ in neural.subset() if name == "neural_resident")
    return [("neural_texels", "3DNTC: a field over texels", "5.7", with_values(small, edit), "TXF-S13")]


def faulty():
    """Clauses 5.5 to 6.5 and 10."""
    return fields() + uv_attributes() + uv_elements() + neural_over_texels()
