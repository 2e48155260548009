"""Rivals that code images of UVs: real encoders keep what they are asked for, and decoders get nothing but what was counted."""

import dataclasses
import json
import shutil
import sys

import numpy as np
import pytest
from shapes import crossing_sheets, sphere

from texfcodec.metrics.views import mesh_psnr_3d
from texfcodec.report import Report
from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench.methods import find, image_codecs, parametrise

QUALITIES = {"hevc": (22, 40), "av1": (12, 45), "avif": (12, 45), "webp": (95, 30), "jpeg": (92, 30), "jxl": (0.5, 6.0),
             "avif6": (90, 30), "webp4": (95, 30), "etc1s": (100, 1), "uastc": (100, 1)}
LEAST_PSNR = {"hevc": 42, "av1": 42, "avif": 42, "webp": 40, "jpeg": 41, "jxl": 43, "avif6": 42,
              "webp4": 40, "etc1s": 33, "uastc": 38}  # dB at the first of these


@pytest.fixture(params=list(image_codecs.CODECS))
def codec(request):
    """Each codec that is installed."""
    if sentence := image_codecs.missing(request.param):
        pytest.skip(sentence)
    return request.param


@pytest.fixture
def needs_hevc():
    pytest.importorskip("av", reason='PyAV is not installed: pip install "texfcodec[rivals]"')


@pytest.fixture
def needs_uvatlas():
    if sentence := parametrise.missing("uvatlas"):
        pytest.skip(sentence)


def picture(height=66, width=97):
    """Waves of colour and one sharp edge: uint8 [H, W, 3]."""
    y, x = np.mgrid[:height, :width]
    waves = [128 + 70 * np.sin(x / 9 + k) * np.cos(y / (7 + k)) + 40 * (x > y) for k in range(3)]
    return np.clip(np.dstack(waves), 0, 255).astype(np.uint8)


def psnr(a, b):
    """dB of two uint8 images."""
    return 10 * np.log10(255**2 / max(((a.astype(float) - b) ** 2).mean(), 1e-9))


def patch(alpha=False, side=64):
    """A square of two textured triangles."""
    corners, faces = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64), np.array([[0, 1, 2], [0, 2, 3]])
    image = np.dstack([picture(side, side), np.full((side, side), 255, np.uint8)])
    if alpha:
        image[..., 3] = np.linspace(0, 255, side).astype(np.uint8)
    return Scene(np.insert(corners, 2, 0.5, axis=1), faces, np.zeros(2, np.int64), corners[faces], None,
                 [Material("cloth", texture=0, alpha_mode=2 if alpha else 0)], [Texture(image)])


def globe():
    """A sphere with a map around it, whose last meridian wraps."""
    positions, faces = sphere(8)
    x, y, z = positions[faces].transpose(2, 0, 1)
    u, v = np.arctan2(y, x) / (2 * np.pi) + 0.5, np.arccos(np.clip(z, -1, 1)) / np.pi
    u = np.where((np.ptp(u, axis=1) > 0.5)[:, None] & (u < 0.5), u + 1, u)
    image = np.dstack([picture(64, 128), np.full((64, 128), 255, np.uint8)])
    return Scene(positions, faces, np.zeros(len(faces), np.int64), np.stack([u, v], axis=2), None, [Material("globe", texture=0)],
                 [Texture(image)])


# Images.


def test_codecs_keep_a_picture_of_odd_sides(codec):
    image = picture()
    good, bad = (image_codecs.enc_image(image, codec, quality) for quality in QUALITIES[codec])
    decoded = [image_codecs.dec_image(data, codec, 97, 66) for data in (good, bad)]
    assert decoded[0].shape == (66, 97, 4) and decoded[0].dtype == np.uint8 and (decoded[0][..., 3] == 255).all()
    assert psnr(decoded[0][..., :3], image) > LEAST_PSNR[codec]
    assert len(bad) < len(good) and psnr(decoded[1][..., :3], image) < psnr(decoded[0][..., :3], image) - 3


def test_codecs_keep_alpha_as_well_as_colour(codec):
    image = np.dstack([picture(40, 50), picture(40, 50)[:, :, 1]])
    data = image_codecs.enc_image(image, codec, QUALITIES[codec][0])
    decoded = image_codecs.dec_image(data, codec, 50, 40)
    assert psnr(decoded[..., 3], image[..., 3]) > LEAST_PSNR[codec] - 2
    assert psnr(decoded[..., :3], image[..., :3]) > LEAST_PSNR[codec] - 6  # WebP and AVIF may lose colours that alpha hides


def test_codecs_take_a_single_texel(codec):
    image = np.full((1, 1, 3), 90, np.uint8)
    decoded = image_codecs.dec_image(image_codecs.enc_image(image, codec, QUALITIES[codec][0]), codec, 1, 1)
    assert decoded.shape == (1, 1, 4) and np.abs(decoded[..., :3].astype(int) - 90).max() <= 4


def test_full_chroma_is_closer_where_it_is_asked_for():
    if sentence := image_codecs.missing("hevc"):
        pytest.skip(sentence)
    image = np.random.default_rng(2).integers(0, 2, (32, 32, 3), np.uint8).repeat(2, axis=0).repeat(2, axis=1)[1:, 1:] * 200
    half, full = (image_codecs.dec_image(image_codecs.enc_image(image, "hevc", 4, chroma), "hevc", 63, 63)[..., :3]
                  for chroma in ("420", "444"))
    assert psnr(full, image) > psnr(half, image) + 6


@pytest.mark.parametrize("weights", [image_codecs.BT709, image_codecs.BT601])
def test_colours_come_back_from_their_planes(weights):
    image = np.random.default_rng(5).integers(0, 256, (32, 48, 3), np.uint8)
    planes = image_codecs.to_yuv(image, weights, "444")
    assert np.abs(image_codecs.from_yuv(planes, weights).astype(int) - image).max() <= 2
    grey = np.repeat(image[..., :1], 3, axis=2)
    luma, *chroma = image_codecs.to_yuv(grey, weights, "420")
    np.testing.assert_array_equal(luma, grey[..., 0])
    assert all((plane == image_codecs.NEUTRAL).all() and plane.shape == (16, 24) for plane in chroma)


def nal_units(stream):
    """{NAL unit type: payload without emulation prevention} of an Annex B stream."""
    units = stream.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")[1:]
    return {unit[0] >> 1 & 63: unit[2:].replace(b"\0\0\3", b"\0\0") for unit in units}


class Bits:
    """Reads the bits of a NAL unit."""

    def __init__(self, data):
        self._bits, self._at = "".join(f"{byte:08b}" for byte in data[:64]), 0

    def u(self, count):
        self._at += count
        return int(self._bits[self._at - count : self._at], 2)

    def ue(self):
        zeros = 0
        while not self.u(1):
            zeros += 1
        return (1 << zeros) - 1 + (self.u(zeros) if zeros else 0)

    def se(self):
        value = self.ue()
        return (value + 1) // 2 if value % 2 else -(value // 2)


@pytest.mark.parametrize("qp", [22, 35, 45, 51])
def test_qp_of_hevc_is_the_one_asked_for(needs_hevc, qp):
    units = nal_units(image_codecs.enc_image(picture(), "hevc", qp))
    assert set(units) == {32, 33, 34, 20} or set(units) == {32, 33, 34, 19}  # parameter sets and one IDR picture, no SEI
    pps, piece = Bits(units[34]), Bits(units.get(19) or units[20])
    pps.ue(), pps.ue(), pps.u(7), pps.ue(), pps.ue()
    base = 26 + pps.se()
    piece.u(2), piece.ue()
    assert piece.ue() == 2  # an I slice
    piece.u(2)  # sample adaptive offset of luma and chroma
    assert base + piece.se() == qp


def test_av1_is_the_avif_file_without_its_boxes():
    for name in ("av1", "avif"):
        if sentence := image_codecs.missing(name):
            pytest.skip(sentence)
    image = picture(64, 64)
    bare, file = (image_codecs.enc_image(image, name, 20) for name in ("av1", "avif"))
    assert file.endswith(bare) and 200 < len(file) - len(bare) < 400
    with pytest.raises(ValueError, match="no mdat"):
        image_codecs.av1_payload(file[:200])
    ours, theirs = (image_codecs.dec_image(data, name, 64, 64) for data, name in ((bare, "av1"), (file, "avif")))
    assert psnr(ours, theirs) > 38  # another filter for chroma


@pytest.mark.parametrize("codec, quality, chroma, what", [
    ("mpeg2", 3, "420", "codec must be"), ("hevc", 52, "420", "from 0 to 51"), ("hevc", 30.5, "420", "QP"),
    ("jpeg", True, "420", "quality of jpeg"), ("webp", "high", "420", "quality of webp"), ("av1", 3, "422", "chroma must be")])
def test_arguments_out_of_range_are_refused(codec, quality, chroma, what):
    with pytest.raises(ValueError, match=what):
        image_codecs.enc_image(picture(), codec, quality, chroma)


@pytest.mark.parametrize("codec, module", [("hevc", "av"), ("av1", "av"), ("jxl", "imagecodecs")])
def test_codec_that_is_not_installed_says_how_to_get_it(monkeypatch, codec, module):
    monkeypatch.setitem(sys.modules, module, None)
    assert 'pip install "texfcodec[rivals]"' in image_codecs.missing(codec)
    assert find("uv").missing({"codec": codec}) == image_codecs.missing(codec)
    assert image_codecs.missing("jpeg") is None and find("uv").missing({"codec": "jpeg"}) is None
    with pytest.raises(LookupError, match="pip install"):
        image_codecs.enc_image(picture(), codec, 9)


# Meshes.


def coded(scene, folder, **options):
    """(what encode says, the decoded Scene): the decoder gets copies of the files that it may have, in a folder of their own."""
    options = {"codec": "jpeg", "quality": 92} | options
    folder.mkdir(parents=True)
    facts = json.loads(json.dumps(find("uv").encode(scene, options, folder, 1, Report())))
    other = folder.parent / (folder.name + "-decoder")
    shutil.copytree(folder, other)
    shutil.rmtree(folder)
    decoded = find("uv").decode(other, options, 1, Report())
    assert find("uv").values_sha256(decoded) == facts["reconstruction_sha256"]
    counted = [path.stat().st_size for path in other.iterdir() if path.name.startswith(("mesh", "image"))]
    assert sum(counted) == facts["bytes"]["total"]
    assert facts["bytes"]["total"] == sum(facts["bytes"][part] for part in ("geometry", "uv", "texture"))
    return facts, decoded


def test_source_comes_back_through_files_that_count(tmp_path):
    scene = globe()
    facts, decoded = coded(scene, tmp_path / "a")
    assert facts["uv_bits"] == 12 and facts["meshes"] == 1 and facts["bytes"]["uv"] > 0
    assert len(decoded.faces) == len(scene.faces)
    assert mesh_psnr_3d(scene, decoded, 4000)["y"] > 35


def test_geometry_is_the_same_bytes_whatever_codes_the_texture(tmp_path):
    scene, counted = globe(), {}
    scene.materials.append(dataclasses.replace(scene.materials[0], double_sided=True))
    scene.face_material = np.arange(len(scene.faces)) % 2  # units of ours apart, meshes of others perhaps
    for name, options in {"texf": {"resolution": 16, "support": "voxels", "effects": "none", "refine": "off"},
                          "uv": {"codec": "jpeg"}, "vertex_colours": {"density": 1}}.items():
        folder = tmp_path / name
        folder.mkdir()
        counted[name] = find(name).encode(scene, options, folder, 1, Report())["bytes"]
    assert len({sizes["geometry"] for sizes in counted.values()}) == 1
    ours = counted["texf"]
    assert ours["total"] == sum(size for part, size in ours.items() if part != "total")
    assert ours["placement"] > ours["geometry"] / 9


def test_results_are_of_other_code_when_a_shared_file_changes(monkeypatch, tmp_path):
    names = ("uv", "texf", "astc", "bc7", "vertex_colours", "serialized", "sdf", "external")
    before = {name: find(name).version() for name in names}
    from tools.bench.methods import draco_mesh

    changed = tmp_path / "draco_mesh.py"
    changed.write_text("# other code")
    monkeypatch.setattr(draco_mesh, "__file__", str(changed))
    assert not [name for name in names if find(name).version() == before[name]]


def test_more_uv_bits_cost_more_and_are_closer(tmp_path):
    scene, found = globe(), []
    for bits in (6, 12):
        facts, decoded = coded(scene, tmp_path / str(bits), uv_bits=bits)
        found.append((facts["bytes"]["uv"], mesh_psnr_3d(scene, decoded, 4000)["y"]))
    assert found[0][0] < found[1][0] and found[0][1] < found[1][1] - 3


def test_bits_follow_the_image_and_its_repeats():
    from tools.bench.methods.draco_mesh import rival_of
    from tools.bench.methods.uv import DEFAULTS, uv_bits_of

    scene = patch()
    assert uv_bits_of(rival_of(scene), DEFAULTS) == 12
    assert uv_bits_of(rival_of(dataclasses.replace(scene, corner_uv=scene.corner_uv * 8)), DEFAULTS) == 15
    large = dataclasses.replace(scene, textures=[Texture(np.zeros((4, 4096, 4), np.uint8))])
    assert uv_bits_of(rival_of(large), DEFAULTS) == 13


def test_images_of_one_content_count_once(tmp_path):
    scene = patch()
    once, _ = coded(scene, tmp_path / "a")
    scene.textures.append(Texture(scene.textures[0].image.copy()))
    scene.materials.append(Material("other", texture=1))
    scene.face_material = np.array([0, 1])
    twice, decoded = coded(scene, tmp_path / "b")
    assert twice["bytes"]["texture"] == once["bytes"]["texture"] and len(twice["images"]) == 1
    assert sorted(decoded.face_material) == [0, 1] and len(decoded.textures) == 2


def test_alpha_that_shows_is_coded_and_counted(tmp_path):
    shown, decoded = coded(patch(alpha=True), tmp_path / "a")
    hidden = patch(alpha=True)
    hidden.materials[0].alpha_mode = 0
    opaque, _ = coded(hidden, tmp_path / "b")
    assert psnr(decoded.textures[0].image[..., 3], patch(alpha=True).textures[0].image[..., 3]) > 38
    assert shown["bytes"]["texture"] > opaque["bytes"]["texture"] + 8


def test_materials_stay_on_their_faces(tmp_path):
    scene = crossing_sheets()
    _, decoded = coded(scene, tmp_path / "a")
    assert [(m.name, m.alpha_mode, m.texture) for m in decoded.materials] == [("stone", 0, 0), ("glass", 2, 0)]
    for m in (0, 1):
        ours, theirs = (np.sort(s.positions[s.faces[s.face_material == m]].reshape(-1, 3), axis=0) for s in (scene, decoded))
        np.testing.assert_allclose(ours, theirs, atol=1e-3)


def test_smaller_images_cost_less(tmp_path):
    full, _ = coded(patch(side=128), tmp_path / "a")
    half, decoded = coded(patch(side=128), tmp_path / "b", scale=0.5)
    assert half["bytes"]["texture"] < full["bytes"]["texture"] and decoded.textures[0].image.shape == (64, 64, 4)


@pytest.mark.parametrize("parametrisation", ["source", "xatlas"])
def test_scene_without_a_texture_says_so(tmp_path, parametrisation):
    scene = dataclasses.replace(patch(), materials=[Material("bare")])
    with pytest.raises(LookupError, match="no texture"):
        find("uv").encode(scene, {"codec": "jpeg", "quality": 9, "parametrisation": parametrisation}, tmp_path, 1, Report())


@pytest.mark.parametrize("name, value", [("parametrisation", "planes"), ("scale", 0), ("size", -1), ("uv_bits", 3),
                                         ("uv_bits", "x"), ("seconds", "long")])
def test_options_of_uv_out_of_range_are_refused(name, value):
    from tools.bench.methods.uv import checked

    with pytest.raises(ValueError, match=f"{name} must be"):
        checked({"codec": "jpeg", name: value})


# New parametrisations.


def test_faces_are_found_again_however_they_are_turned():
    random = np.random.default_rng(4)
    faces = random.integers(0, 99, (50, 3, 5))
    order, turn = random.permutation(50), random.integers(0, 3, 50)
    mixed = np.take_along_axis(faces[order], ((np.arange(3) + turn[:, None]) % 3)[..., None], axis=1)
    face, found = parametrise.matched(faces, mixed)
    np.testing.assert_array_equal(face, order)
    np.testing.assert_array_equal(found, turn)
    with pytest.raises(ValueError, match="other faces"):
        parametrise.matched(faces, mixed[:, ::-1])


def test_new_parametrisation_shows_the_source_and_is_kept_for_the_next_rate(tmp_path):
    scene = globe()
    facts, decoded = coded(scene, tmp_path / "a", parametrisation="xatlas")
    assert len(decoded.textures) == 1 and facts["source_texels"] <= decoded.textures[0].image[..., 0].size * 1.05
    assert mesh_psnr_3d(scene, decoded, 4000)["y"] > 33
    again, other = coded(scene, tmp_path / "b", parametrisation="xatlas", quality=20)
    assert len(list(tmp_path.glob("atlas-*.npz"))) == 1 and not list(tmp_path.glob("*.part"))
    assert again["parametrisation_seconds"] == facts["parametrisation_seconds"] > 0
    np.testing.assert_array_equal(other.corner_uv, decoded.corner_uv)
    coded(scene, tmp_path / "c", parametrisation="xatlas", size=64)
    assert len(list(tmp_path.glob("atlas-*.npz"))) == 2


def test_uvatlas_gives_every_face_room_in_the_image(needs_uvatlas):
    from texfcodec.geometry.surface import make_surface
    from texfcodec.options import EncodeOptions

    surface = make_surface(globe(), EncodeOptions(position_bits=14))
    uv = parametrise.new_uv(surface.lattice, surface.faces, parametrise.Request("uvatlas", 256, 120))
    sides = uv[:, 1:] - uv[:, :1]
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
    assert uv.min() >= 0 and uv.max() <= 1 and (area > 0).all() and 0.4 < area.sum() < 1


def test_uvatlas_on_what_is_no_manifold_fails_with_a_sentence(needs_uvatlas):
    fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0.2], [0, 0, 1]], np.float64)
    with pytest.raises(parametrise.NoAtlas, match=r"UVAtlas ended with status -?\d+ on 3 faces, .* no manifold: \w"):
        parametrise._by_uvatlas(points, fan, 64, 60)


def test_uvatlas_that_takes_too_long_is_ended(needs_uvatlas):
    with pytest.raises(parametrise.NoAtlas, match="more than 0.05 s for 1 faces"):
        parametrise._by_uvatlas(np.eye(3), np.array([[0, 1, 2]]), 64, 0.05)


def test_uvatlas_that_is_not_installed_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "open3d", None)
    options = {"codec": "jpeg", "quality": 50, "parametrisation": "uvatlas"}
    assert 'pip install "texfcodec[rivals]"' in find("uv").missing(options)
    with pytest.raises(LookupError, match="open3d"):
        find("uv").encode(patch(), options, tmp_path, 1, Report())


def test_astc_takes_a_new_parametrisation_with_sixteen_bit_uvs(tmp_path):
    pytest.importorskip("astc_encoder", reason='astc-encoder-py is not installed: pip install "texfcodec[baselines]"')
    scene, options = globe(), {"block": "4x4", "quality": 60, "parametrisation": "xatlas"}
    (tmp_path / "a").mkdir()
    facts = find("astc").encode(scene, options, tmp_path / "a", 1, Report())
    decoded = find("astc").decode(tmp_path / "a", options, 1, Report())
    assert facts["images"] == [(90, 90)] and facts["bytes"]["texture"] == 23 * 23 * 16
    assert facts["bytes"]["uv"] == 4 * facts["uv_vertices"]
    assert find("astc").values_sha256(decoded) == facts["reconstruction_sha256"]
    assert mesh_psnr_3d(scene, decoded, 4000)["y"] > 33
    with pytest.raises(ValueError, match="base colour alone"):
        find("astc").encode(scene, options | {"maps": "all"}, tmp_path / "a", 1, Report())
