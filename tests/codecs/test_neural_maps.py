"""3DNTC of whole materials: one payload answers all channels, each with its weight, and none where a material has no map."""

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from shapes import crossing_sheets

from texfcodec import EncodeOptions, decode
from texfcodec.codecs import codec_of
from texfcodec.codecs.base import Source as CodecSource
from texfcodec.codecs.neural.fit import Fit
from texfcodec.codecs.neural.fit_samples import Samples, Source, component_weights
from texfcodec.codecs.neural.payload import Level, Payload, Tables
from texfcodec.encoder.encode import Encoder, encode_scene
from texfcodec.encoder.values.map_planes import groups_of
from texfcodec.geometry.areas import sample_surface
from texfcodec.geometry.surface import make_surface
from texfcodec.report import Report
from texfcodec.scene.channels import BASE_COLOUR, BY_NAME
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import Material, Scene, Texture

SIDE, CONSTANT, STEPS = 64, 100, 2000
OPTIONS = {"codec": "3dntc", "threads": 1, "resolution": 32, "effects": "all", "resident_bytes": 40_000, "fit_engine": "numba"}


def painted(seed, low=0, high=256):
    return np.random.default_rng(seed).integers(low, high, (SIDE, SIDE, 4), np.uint8)


def smooth(*levels):
    """An image that goes from one side to the other, by component from 40 to `levels`."""
    ramp = np.linspace(40, np.array([*levels, 255]), SIDE)
    return np.rint(np.broadcast_to(ramp[:, None], (SIDE, SIDE, 4))).astype(np.uint8)


def two_sheets(normal=None, data=None, base=None):
    """Two squares side by side: one of a material with normals, occlusion, roughness and metallic, one of base colour alone."""
    side = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    data = np.full((SIDE, SIDE, 4), CONSTANT, np.uint8) if data is None else data
    images = [smooth(200, 90, 160) if base is None else base, smooth(128, 200, 220) if normal is None else normal, data]
    maps = {"normal": 1, "occlusion": 2, "roughness": 2, "metallic": 2}
    return Scene(np.concatenate([np.insert(side, 2, 0.5, axis=1), np.insert(side + [1.5, 0], 2, 0.5, axis=1)]),
                 np.concatenate([faces, faces + 4]), np.array([0, 0, 1, 1]), np.concatenate([side[faces], side[faces]]), None,
                 [Material("rich", texture=0, maps=maps), Material("plain", texture=0)], [Texture(image) for image in images])


def source_of(scene, **settings):
    """What a joint codec is handed of a scene."""
    return Encoder(scene=scene).filled(EncodeOptions(**{**OPTIONS, **settings}), Report()).source


def places_on(source, count=2000):
    return sample_surface(source.surface.lattice.astype(np.float64), source.surface.faces, count, 7)


def columns_of(source):
    """Columns of each channel among all components, by name."""
    ends = np.cumsum([c.components for c in source.channels]).tolist()
    return {c.name: list(range(end - c.components, end)) for c, end in zip(source.channels, ends, strict=True)}


def test_samples_without_maps_are_colours_weighed_by_alpha_alone():
    scene = crossing_sheets()
    scene.textures[0].image[:8, :, 3] = 0
    source = source_of(scene)
    face, bary = places_on(source)
    got = Source(source, 1).at(face, bary, 1)
    rgba = np.rint(sample_source(pack_source(scene, source.surface.origin_face), face, bary)).astype(np.uint8)
    assert source.maps is None and (rgba[:, 3] == 0).any() and (rgba[:, 3] == 255).any()
    assert np.array_equal(got.target, rgba)
    assert np.array_equal(got.share, np.column_stack([np.maximum(rgba[:, [3, 3, 3]], 1), np.full(len(face), 255)]))


def test_samples_of_colour_and_alpha_are_those_of_before_there_were_maps():
    """Frozen: payloads of assets without maps keep their bytes. What is drawn is fitted by kernels whose last bits depend on the
    processor, so streams cannot be frozen themselves."""
    scene = crossing_sheets()
    surface = make_surface(scene, EncodeOptions(codec="3dntc"))
    shown = Source(CodecSource(scene, surface, np.arange(4) // 2, [], groups_of(set(), True)), 1)
    found = []
    for drawn in (shown.draw(3000, [0, 1]), shown.draw_busy(3000, [0, 0])):
        total = hashlib.sha256()
        for array in (drawn.position.astype("<i4"), drawn.target, drawn.share, drawn.field.astype("<i2")):
            total.update(np.ascontiguousarray(array))
        found.append(total.hexdigest()[:16])
    assert found == ["1ae025f36937568f", "3bce5ce15272a765"]


def test_samples_hold_what_maps_show_and_nothing_where_there_is_none():
    source = source_of(two_sheets(data=painted(1)))
    face, bary = places_on(source)
    got, columns = Source(source, 2).at(face, bary, 1), columns_of(source)
    assert list(columns) == ["base_colour", "normal_object", "occlusion", "roughness", "metallic"]
    rich, image = source.surface.material[face] == 0, replace(two_sheets(data=painted(1)), materials=[Material(texture=2)] * 2)
    data = np.rint(sample_source(pack_source(image, source.surface.origin_face), face, bary))
    for name, column in (("occlusion", 0), ("roughness", 1), ("metallic", 2)):
        assert np.array_equal(got.target[rich, columns[name][0]], data[rich, column])
    bent = np.rint(source.maps("normal_object", face[rich], bary[rich], 1))
    assert np.array_equal(got.target[np.ix_(rich, columns["normal_object"])], bent) and np.ptp(bent, axis=0).max() > 10
    maps = [c for name, mine in columns.items() if name != "base_colour" for c in mine]
    assert 0.4 < rich.mean() < 0.6 and not got.share[np.ix_(~rich, maps)].any()
    assert got.share[rich].all() and got.share[:, :3].all()


def test_what_cannot_be_seen_weighs_next_to_nothing_in_maps_too():
    scene = two_sheets(base=painted(3))
    scene.materials[0] = replace(scene.materials[0], alpha_mode=2)
    source = source_of(scene)
    face, bary = places_on(source)
    got, columns = Source(source, 1).at(face, bary, 1), columns_of(source)
    rich = source.surface.material[face] == 0
    alpha = np.maximum(got.target[rich, columns["alpha"][0]], 1)
    weight = component_weights(source.channels)[columns["roughness"][0]]
    assert np.array_equal(got.share[rich, columns["roughness"][0]], np.maximum(np.rint(alpha * weight), 1))


def test_weights_are_those_of_the_table_with_the_largest_for_one():
    heavy, light = (replace(BY_NAME[name], weight=w) for name, w in (("normal_object", 4.0), ("roughness", 0.5)))
    assert component_weights((BASE_COLOUR, heavy, light)).tolist() == [0.25] * 3 + [1.0] * 3 + [0.125]
    assert component_weights((BASE_COLOUR,)).tolist() == [1.0] * 3


def test_places_are_busy_where_a_map_is_by_its_weight():
    data = np.full((SIDE, SIDE, 4), CONSTANT, np.uint8)
    data[:, SIDE // 2 :] = painted(5)[:, SIDE // 2 :]
    source = source_of(two_sheets(data=data, base=np.full((SIDE, SIDE, 4), 90, np.uint8),
                                  normal=np.full((SIDE, SIDE, 4), 128, np.uint8)))
    shown, found = Source(source, 1), []
    low, high = shown.lattice[:, 0].min(), shown.lattice[:, 0].max()
    for weight in (1.0, 0.05, 0.004):
        shown.weights = np.where(np.arange(shown.components) < 6, 1, weight).astype(np.float32)
        x = (shown.draw_busy(20_000, [0, 0]).position[:, 0] / shown.scale - low) / (high - low) * 2.5
        found.append(((x > 0.5) & (x < 1)).sum() / (x < 0.5).sum())
    assert found[0] > 3.5 and 1.5 < found[1] < 2.5 and 1.05 < found[2] < 1.3, found


def test_a_lost_channel_gives_no_gradient_and_does_not_count():
    """Its output may say anything; the others learn as without it."""
    random = np.random.default_rng(5)
    position, share = random.integers(0, 1 << 24, (600, 3)).astype(np.int32), np.full((600, 4), 255, np.uint8)
    share[:, 3] = 0
    grids = [np.arange(8**3)]
    design = Payload(8, 2, 16, (12, 8), (Level(8, 0, 0, (8**3,)),), 4)

    def fit_of(seen):
        target = random.integers(0, 256, (600, 1)).repeat(4, axis=1).astype(np.uint8)
        target[:, 3] = seen
        target[:, :3] = position >> 16
        samples = Samples(position, target, share, np.zeros(600, np.int16))
        return Fit(design, [Tables(design, 0, grids)], samples, samples)

    fits = [fit_of(0), fit_of(255)]
    for fit in fits:
        with ThreadPoolExecutor(1) as pool:
            fit.learn(fit.samples, (fit.cell, fit.corners), pool)
        last = fit.gradients[1][0][2]
        assert not last[3].any() and last[:3].any()
    assert all(np.array_equal(a, b) for a, b in zip(fits[0].gradients, fits[1].gradients, strict=True))
    assert fits[0].psnr() == fits[1].psnr() and fits[0].errors()[1, 3] == 0


# The whole way.


@pytest.fixture(scope="module")
def made():
    return encode_scene(two_sheets(), EncodeOptions(**OPTIONS, steps=STEPS))


def test_a_constant_map_is_answered_within_a_level(made):
    scene, texf = two_sheets(), decode(made.data)
    surface = make_surface(scene, EncodeOptions(**OPTIONS))
    face, bary = sample_surface(scene.positions, scene.faces[:2], 1000, 3)
    points = np.einsum("mk,mkc->mc", bary, scene.positions[scene.faces[face]])
    asked = texf.query_planes(0, ["occlusion", "roughness", "metallic", "normal_object"], points, None)
    for name in ("occlusion", "roughness", "metallic"):
        assert np.abs(asked[name] - CONSTANT).max() <= 1
    assert surface.material.tolist() == [0, 0, 1, 1]
    want = source_of(scene).maps("normal_object", face, bary, 1)
    assert np.abs(asked["normal_object"] - want).mean() < 3


def test_a_payload_of_maps_decodes_to_what_the_encoder_promised(made):
    texf, total = decode(made.data), hashlib.sha256()
    for field in texf.fields:
        for channel in texf.channels:
            total.update(np.ascontiguousarray(field.keys, "<i8"))
            total.update(np.ascontiguousarray(field.planes[channel.name]))
    assert total.hexdigest() == made.reconstruction_sha256
    assert {n for m in texf.materials for n in m.maps} == {"normal", "occlusion", "roughness", "metallic"}


def test_resident_bytes_count_the_outputs_of_all_channels(made):
    from texfcodec.codecs.neural.payload import resident_bytes

    payload = decode(made.data).evaluators[0].payload
    kept = made.choices["resident"]
    assert payload.components == 9 and kept["total"] <= OPTIONS["resident_bytes"]
    assert resident_bytes(payload, kept["index"]) == kept


def test_the_report_tells_of_every_channel(made):
    told = json.loads(json.dumps(made.choices["fit"]))
    assert list(told["psnr_channels"]) == ["base_colour", "normal_object", "occlusion", "roughness", "metallic"]
    assert told["psnr_rgb"] == told["psnr_channels"]["base_colour"] and told["psnr_channels"]["roughness"] > 45
    assert told["psnr_judged"] == pytest.approx(told["log"][-1]["psnr"], abs=0.1)
    lines = list(codec_of("3dntc").result_lines({**made.choices, **made.counts}))
    assert any("normal_object" in line and "metallic" in line and "base_colour" not in line for line in lines)


def test_pictures_leave_payloads_with_maps_alone_and_the_report_says_why():
    told = encode_scene(two_sheets(), EncodeOptions(**OPTIONS, steps=5, refine="render")).choices["refinement"]
    assert told["kind"] == "off" and "maps" in told["reason"]
