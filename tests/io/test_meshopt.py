"""glTF with EXT_meshopt_compression: every mode and filter, files without the package, and buffers that lie."""


import numpy as np
import pytest
from mesh_files import RED_BLUE, SQUARE, SQUARE_UV, TWO, Builder, encoded, load_bytes, refusal

from texfcodec.errors import InputError, LimitError

EXTENSION = "EXT_meshopt_compression"


@pytest.fixture
def meshopt():
    package = pytest.importorskip("meshoptimizer", reason="meshoptimizer is not installed: pip install 'texfcodec[formats]'")
    package.encode_vertex_version(0)  # what the extension of 2020 allows; its KHR successor has version 1 too
    return package


def exponential(values):
    """Floats -> uint32: a signed mantissa of 24 bits and an exponent above it, exact for float32."""
    mantissa, exponent = np.frexp(np.asarray(values, np.float64))
    mantissa = np.round(mantissa * (1 << 22)).astype(np.int64)
    return ((exponent - 22).astype(np.int64) << 24 | mantissa & 0xFFFFFF).astype(np.uint32)


def compress(builder, accessor, packed, mode, stride, **more):
    """Turn the view of an accessor into a compressed one whose plain buffer does not exist."""
    view = builder.tree["bufferViews"][builder.tree["accessors"][accessor]["bufferView"]]
    count = view["byteLength"] // stride
    place = builder.view(packed)
    inner = builder.tree["bufferViews"].pop(place)
    view["extensions"] = {EXTENSION: {**inner, "mode": mode, "byteStride": stride, "count": count, **more}}
    view |= {"buffer": 1, "byteOffset": 0}
    return view["extensions"][EXTENSION]


class Packed(Builder):
    """A textured square of four compressed views; `extension` holds their objects by name."""

    def __init__(self, meshopt, sequence=False, index=np.uint16, filtered=False):
        super().__init__()
        material = self.material(self.texture(encoded(RED_BLUE)))
        primitive = self.primitive(positions=SQUARE * 3 - 1, indices=TWO.astype(index), uv=SQUARE_UV, material=material)
        places = {**primitive["attributes"], "indices": primitive["indices"]}
        encode = meshopt.encode_index_sequence if sequence else meshopt.encode_index_buffer
        faces = encode(TWO.astype(np.uint32).reshape(-1), 6, 4)
        points = exponential(SQUARE * 3 - 1) if filtered else SQUARE * 3 - 1
        self.extension = {
            "POSITION": compress(self, places["POSITION"], meshopt.encode_vertex_buffer(points), "ATTRIBUTES", 12,
                                 **({"filter": "EXPONENTIAL"} if filtered else {})),
            "TEXCOORD_0": compress(self, places["TEXCOORD_0"], meshopt.encode_vertex_buffer(SQUARE_UV), "ATTRIBUTES", 8),
            "indices": compress(self, places["indices"], faces, "INDICES" if sequence else "TRIANGLES",
                                np.dtype(index).itemsize)}
        self.tree["extensionsRequired"] = [EXTENSION]

    def glb(self):
        fallback = {"byteLength": 1 << 20, "extensions": {EXTENSION: {"fallback": True}}}
        return self.with_buffers([{"byteLength": len(self.blob)}, fallback])


@pytest.mark.parametrize("options", [{}, {"sequence": True}, {"index": np.uint32}, {"filtered": True},
                                     {"sequence": True, "index": np.uint32}])
def test_compressed_views_load_as_plain_ones(tmp_path, meshopt, options):
    scene = load_bytes(tmp_path, Packed(meshopt, **options), strict=True)
    np.testing.assert_array_equal(np.sort(scene.positions[scene.faces], axis=1), np.sort((SQUARE * 3 - 1)[TWO], axis=1))
    place = scene.positions[scene.faces][..., :2]
    np.testing.assert_allclose(scene.corner_uv, np.stack([(place[..., 0] + 1) / 3, 1 - (place[..., 1] + 1) / 3], axis=2),
                               atol=1e-7)
    assert scene.warnings == [] and scene.dropped == []


def test_a_form_that_is_not_supported_gives_way_to_a_plain_copy(tmp_path):
    builder = Builder()
    builder.primitive()
    view = builder.tree["bufferViews"][0]
    view["extensions"] = {EXTENSION: {"mode": "ATTRIBUTES", "filter": "COLOR", "count": 4, "byteStride": 12, "buffer": 0,
                                      "byteLength": view["byteLength"]}}
    np.testing.assert_array_equal(load_bytes(tmp_path, builder).positions, SQUARE)
    builder.tree["extensionsRequired"] = [EXTENSION]
    assert refusal(tmp_path, builder).code == "TXF-I30"


def test_a_fallback_without_bytes_is_no_plain_copy(tmp_path, meshopt):
    builder = Packed(meshopt)
    del builder.tree["extensionsRequired"]
    builder.extension["POSITION"]["filter"] = "COLOR"
    assert refusal(tmp_path, builder).code == "TXF-I30"


def test_a_view_of_two_accessors_is_unpacked_once(tmp_path, meshopt, monkeypatch):
    from texfcodec.io.gltf import document

    builder, asked = Packed(meshopt), []
    builder.primitive(indices=TWO)
    first, second = builder.tree["meshes"][0]["primitives"]
    accessors = builder.tree["accessors"]
    accessors[second["attributes"]["POSITION"]] = dict(accessors[first["attributes"]["POSITION"]])
    monkeypatch.setattr(document, "decode_view", lambda *a, real=document.decode_view: asked.append(a[3]) or real(*a))
    scene = load_bytes(tmp_path, builder)
    assert len(scene.faces) == 4 and len(asked) == len(set(asked)) == 3
    np.testing.assert_array_equal(scene.positions[4:], SQUARE * 3 - 1)


def test_triangles_of_a_number_that_is_no_multiple_of_3_are_refused(meshopt):
    from texfcodec.io.gltf.meshopt import decode_view

    with pytest.raises(InputError, match="TXF-I09.*not a multiple of 3"):
        decode_view(bytes(99), {"count": 4, "byteStride": 2, "mode": "TRIANGLES"}, {"byteLength": 8}, 0)


@pytest.mark.parametrize("place, changes, code", [
    ("POSITION", {"count": 10**15}, "TXF-I09"), ("POSITION", {"count": 0}, "TXF-I09"), ("POSITION", {"count": 3}, "TXF-I09"),
    ("POSITION", {"byteStride": 6}, "TXF-I09"), ("POSITION", {"byteStride": 260}, "TXF-I09"),
    ("POSITION", {"byteStride": 16, "count": 3}, "TXF-I12"), ("POSITION", {"mode": "TRIANGLES"}, "TXF-I09"),
    ("POSITION", {"mode": ["ATTRIBUTES"]}, "TXF-I09"), ("POSITION", {"filter": "OCTAHEDRAL"}, "TXF-I09"),
    ("POSITION", {"filter": "COLOR"}, "TXF-I30"), ("POSITION", {"filter": {}}, "TXF-I30"),
    ("POSITION", {"byteLength": 10**9}, "TXF-I11"), ("POSITION", {"byteLength": 9}, "TXF-I12"),
    ("POSITION", {"buffer": 1}, "TXF-I10"), ("POSITION", {"buffer": None}, "TXF-I09"),
    ("indices", {"mode": "ATTRIBUTES"}, "TXF-I09"), ("indices", {"byteStride": 4, "count": 3}, "TXF-I12"),
    ("indices", {"mode": "INDICES"}, "TXF-I12"), ("indices", {"filter": "EXPONENTIAL"}, "TXF-I09"),
    ("indices", {"byteLength": 12}, "TXF-I12"),
])
def test_bent_extensions_end_in_their_code(tmp_path, meshopt, place, changes, code):
    builder = Packed(meshopt)
    builder.extension[place] |= changes
    assert refusal(tmp_path, builder).code == code


@pytest.mark.parametrize("place, count, code", [("POSITION", 1 << 26, "TXF-I12"), ("POSITION", 1 << 40, "TXF-I41"),
                                                ("indices", 3 << 26, "TXF-I12")])
def test_counts_that_agree_but_lie_are_refused_before_memory_is_taken(tmp_path, meshopt, monkeypatch, place, count, code):
    builder = Packed(meshopt)
    entry = builder.extension[place]
    entry["count"] = count
    view = next(view for view in builder.tree["bufferViews"] if view.get("extensions", {}).get(EXTENSION) is entry)
    view["byteLength"] = count * entry["byteStride"]
    decoder = "decode_attributes" if place == "POSITION" else "decode_triangles"
    monkeypatch.setattr(f"texfcodec.io.gltf.meshopt_views.{decoder}", lambda *a: pytest.fail("the decoder was asked"))
    error = refusal(tmp_path, builder)
    assert error.code == code and isinstance(error, LimitError) == (code == "TXF-I41")
