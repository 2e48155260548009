"""KTX2 textures: ETC1S and UASTC, files without the package, and headers that lie.

No package that decodes them encodes them too, so the five files stand here: 8 x 8 pixels in four squares of red, green,
blue and white (clear where the name says alpha), made with alktx2 0.1.7 (basis_universal); zlib and base 85 around them.
"""

import struct
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from damage import with_a_bit_flipped
from format_files import KTX2_FILES, ktx2
from mesh_files import RED_BLUE, SQUARE_UV, Builder, encoded, load_bytes, refusal, textured

from texfcodec.errors import InputError, LimitError, SupportError, TexfError
from texfcodec.io.images import read_image
from texfcodec.io.parts import Notes

WIDTH, HEIGHT, DEPTH, LAYERS, FACES, SCHEME, SGD_SIZE, LEVEL_AT, LEVEL_SIZE, UNPACKED = 20, 24, 28, 32, 36, 44, 72, 80, 88, 96


@pytest.fixture
def basisu():
    return pytest.importorskip("opengl_basisu", reason="opengl-basisu is not installed: pip install 'texfcodec[formats]'")


def textured_by(data, **more):
    """A square whose texture has only a KTX2 source."""
    builder = Builder()
    image = builder.add("images", {"bufferView": builder.view(data), "mimeType": "image/ktx2"})
    texture = builder.add("textures", {"extensions": {"KHR_texture_basisu": {"source": image}}, **more})
    builder.primitive(uv=SQUARE_UV, material=builder.material(texture))
    builder.tree["extensionsRequired"] = ["KHR_texture_basisu"]
    return builder


@pytest.mark.parametrize("kind", KTX2_FILES)
def test_basis_textures_become_rgba(tmp_path, basisu, kind):
    scene = load_bytes(tmp_path, textured_by(ktx2(kind)), strict=True)
    clear = 0 if "alpha" in kind else 255
    squares = [[[255, 0, 0, 255], [0, 255, 0, 255]], [[0, 0, 255, 255], [255, 255, 255, clear]]]
    image = scene.textures[0].image
    assert image.shape == (8, 8, 4) and image.dtype == np.uint8 and scene.warnings == []
    np.testing.assert_allclose(image.astype(int), np.repeat(np.repeat(squares, 4, axis=0), 4, axis=1), atol=3)


def test_a_ktx2_file_beside_an_obj_is_read(tmp_path, basisu):
    (tmp_path / "t.ktx2").write_bytes(ktx2("UASTC"))
    (tmp_path / "m.mtl").write_text("newmtl m\nmap_Kd t.ktx2\n")
    text = "mtllib m.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    scene = load_bytes(tmp_path, text, "a.obj", strict=True)
    assert scene.textures[0].image[0, 0].tolist() == [255, 0, 0, 255]


def test_a_png_beside_the_ktx2_source_is_taken(tmp_path):
    builder = textured_by(b"never looked at")
    builder.tree["textures"][0]["source"] = builder.add("images", {"bufferView": builder.view(encoded(RED_BLUE))})
    assert load_bytes(tmp_path, builder, strict=True).textures[0].image.shape == (1, 2, 4)


def test_textures_are_named_whose_mark_is_not_that_of_their_use(tmp_path, basisu):
    data = bytearray(ktx2("UASTC"))
    assert data[104 + 4 + 8 + 2] == 2  # transferFunction in the data format descriptor: sRGB
    data[104 + 4 + 8 + 2] = 1
    notes = Notes()
    read_image(bytes(data), "t", notes)
    assert "marked as linear" in notes.warnings[0]
    for source, named in ((bytes(data), False), (ktx2("UASTC"), True)):
        builder = textured()
        image = builder.add("images", {"bufferView": builder.view(source)})
        builder.tree["materials"][0]["occlusionTexture"] = {
            "index": builder.add("textures", {"extensions": {"KHR_texture_basisu": {"source": image}}})}
        scene = load_bytes(tmp_path, builder)
        assert scene.materials[0].maps == {"occlusion": 1} and len(scene.warnings) == named
        assert not named or "marked as sRGB" in scene.warnings[0]


def test_without_the_package_the_error_names_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    error = refusal(tmp_path, textured_by(ktx2("ETC1S")))
    assert isinstance(error, SupportError) and error.code == "TXF-I32" and 'pip install "texfcodec[formats]"' in error.message


def bent(data, at, form, value):
    data = bytearray(data)
    struct.pack_into(form, data, at, value)
    return bytes(data)


@pytest.mark.parametrize("kind, at, form, value, family", [
    ("UASTC", 12, "<I", 43, InputError), ("UASTC", WIDTH, "<I", 0, InputError), ("UASTC", WIDTH, "<I", 12, InputError),
    ("UASTC", WIDTH, "<I", 1 << 31, LimitError), ("ETC1S", HEIGHT, "<I", 1 << 31, LimitError),
    ("ETC1S", HEIGHT, "<I", 1 << 20, InputError), ("UASTC", DEPTH, "<I", 2, InputError), ("UASTC", LAYERS, "<I", 9, InputError),
    ("UASTC", FACES, "<I", 6, InputError), ("UASTC", SCHEME, "<I", 9, InputError), ("UASTC", SCHEME, "<I", 1, InputError),
    ("ETC1S", SGD_SIZE, "<Q", 1 << 50, InputError), ("UASTC", LEVEL_AT, "<Q", 1 << 63, InputError),
    ("UASTC", LEVEL_SIZE, "<Q", 1 << 40, InputError), ("UASTC with alpha in Zstandard", UNPACKED, "<Q", 1 << 40, InputError),
    ("UASTC with alpha in Zstandard", UNPACKED, "<Q", 48, InputError),
])
def test_headers_that_lie_are_refused(basisu, kind, at, form, value, family):
    with pytest.raises(family) as caught:
        read_image(bent(ktx2(kind), at, form, value), "t", Notes())
    assert caught.value.code == ("TXF-I40" if family is LimitError else "TXF-I17")


def test_another_size_than_the_header_says_is_refused(basisu, monkeypatch):
    monkeypatch.setattr(basisu, "open", lambda data: SimpleNamespace(width=8, height=4))
    with pytest.raises(InputError) as caught:
        read_image(ktx2("UASTC"), "t", Notes())
    assert caught.value.code == "TXF-I17" and caught.value.details == {"reason": "the transcoder returned another size"}


@pytest.mark.parametrize("kind", KTX2_FILES)
def test_no_prefix_and_no_flipped_bit_leaves_the_coded_errors(basisu, kind):
    data, refused = ktx2(kind), 0
    for damaged in [data[:length] for length in range(12, len(data), 3)] + list(with_a_bit_flipped(data)):
        try:
            assert read_image(damaged, "t", Notes()).shape[2] == 4
        except TexfError as error:
            refused += 1
            assert error.code in ("TXF-I17", "TXF-I40")
    assert refused > len(data) // 6
