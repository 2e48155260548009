"""The good conformance vectors of whole materials (clauses 5.3.1, 5.4.1, 5.4.2 and 5.7), from integers like those of
texels.py."""

import numpy as np

from conformance.make.filter import every, filtered
from conformance.make.good import encoded
from conformance.make.neural import neural
from conformance.make.texels import CLAMPED, MIRRORED, Grid, Image, Patch, picture, ring, stream_of_parts, wall
from texfcodec.codecs.base import Group
from texfcodec.codecs.raht.transform.filter import stage_of
from texfcodec.codecs.raht.transform.planar_rings import PLANAR_TAPS
from texfcodec.scene.channels import ALPHA, BASE_COLOUR, BY_NAME, CHANNELS, LARGEST, MAPS, PARAMETERS
from texfcodec.scene.effects import EFFECTS
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, Material, Texture

BASE = Group((BASE_COLOUR,))
SIZE = (21, 13)
FEW = {"WHOLE_VOXELS": 1, "SLICE_VOXELS": 20, "SLICE_NODES": 4}  # slices of planes that are small


def groups(*names, grey=()):
    """Groups behind that of base colour. names: of their channels, joined by +; grey: those that are."""
    return (BASE, *(Group(tuple(BY_NAME[part] for part in name.split("+")), name in grey) for name in names))


def painted(*maps, **parameters):
    """A Material with maps of these channels."""
    return Material("painted", maps=dict.fromkeys(maps, -1), parameters=parameters)


def over_texels(materials, coded, size=SIZE, **more):
    """A stream of an image on a ring, all of whose faces have the first material."""
    return stream_of_parts([Image(picture(*size))], [ring(size)], materials, groups=coded, **more)


def bare(resolution_patch=None, **more):
    """A ring without UVs: Patch."""
    patch = resolution_patch or ring((8, 8))
    return Patch(patch.lattice, patch.faces, **more)


def over_voxels(materials, coded, resolution=13, **more):
    """A stream of voxels on a ring, all of whose faces have the first material."""
    return stream_of_parts([Grid(resolution, constant=False)], [bare()], materials, groups=coded, **more)


def every_channel(texels):
    """A material that names all there is, and every channel that its faces can have, one a group."""
    names = [c.name for c in CHANNELS[2:] if c.over in ("", "texels" if texels else "voxels")]
    return [painted(*(c.name for c in MAPS))], groups(*names)


def every_parameter():
    """Materials with every parameter, and with numbers at the ends of what binary32 holds."""
    stated = {p.name: tuple(0.25 + (p.number + i) / 8 for i in range(p.count)) for p in PARAMETERS}
    ends = {"normal_scale": (-LARGEST,), "thickness": (LARGEST,), "emissive": (0.0, 2.0**-149, 0.0), "ior": (-0.0,)}
    return [painted(**stated), painted(**ends), Material("plain")]


def every_effect():
    """Materials that together set every bit."""
    above = {name: (0.5,) for name in ("clearcoat", "transmission", "thickness", "iridescence", "anisotropy", "dispersion",
                                       "diffuse_transmission")}
    named = ("normal", "occlusion", "clearcoat_normal", "specular")
    first = painted(*named, emissive=(0.0, 0.5, 0.0), sheen_colour=(0.0, 0.0, 0.1), ior=(1.25,), **above)
    return [first, Material("leaf", alpha_mode=ALPHA_MASK, double_sided=True), Material("veil", alpha_mode=ALPHA_BLEND)]


def no_effect():
    """Maps and parameters that nothing reads: the material is unlit."""
    return painted_unlit("roughness", "emissive", emissive=(1.0, 1.0, 1.0), ior=(2.0,))


def painted_unlit(*maps, **parameters):
    material = painted(*maps, **parameters)
    material.unlit = True
    return material


def some_materials():
    """Three fields: over texels with maps, over voxels with the same material, over voxels without maps."""
    rich, plain = painted("normal", "roughness", "occlusion"), Material("plain")
    coded = groups("normal+occlusion", "normal_object", "roughness")
    parts = [Image(picture(13, 9), MIRRORED), Grid(6, constant=False), Grid(5)]
    first, small = ring((13, 9)), ring((8, 8))
    patches = [first, bare(small, field=1), bare(small, field=1, material=1), bare(small, field=2, material=1)]
    return stream_of_parts(parts, patches, [rich, plain], groups=coded, shifts={(1, 3): 1})


def filtered_plane(data):
    """The stream with a filter stage of drawn taps in its unit of two components."""
    mask = every(2)
    taps = np.random.default_rng(71).choice([t for t in range(-40, 41) if t], PLANAR_TAPS * mask.bit_count())
    return filtered(data, {1: [], 2: [stage_of(mask, taps, 2)], 3: []}, models=8, planar_transform=1, component_cross=16)


def subset():
    """What the encoder writes every day."""
    scene = wall()
    rough = np.dstack([picture(12, 10, 4, seed=4)])
    scene.textures.append(Texture(rough))
    scene.materials[0].maps = dict.fromkeys(("occlusion", "roughness", "metallic"), 1)
    scene.materials[0].parameters = {"roughness": (0.5,)}
    return [
        ("maps_texels", ["a field over texels", "maps of occlusion, roughness and metallic"], ("5.3.1", "5.4.1", "5.4.2"),
         encoded(scene, support="texels", qp=30), (0, 1)),
        ("maps_voxels", [("K = {}", 20), "maps of occlusion, roughness and metallic"], ("5.3.1", "5.4.1", "5.4.2"),
         encoded(scene, resolution=20, qp=30), (0, 1)),
    ]


def channel_groups():
    """Clauses 5.3.1, 5.4.1 and 5.7: which channels there are, and how they are put together."""
    orm = painted("occlusion", "roughness", "metallic")
    veil = [Material("veil", alpha_mode=ALPHA_BLEND, maps={"roughness": -1}), Material("bare")]
    greys = ("emissive", "specular_colour")
    half = [ring(SIZE), ring(SIZE)]
    half[0].faces, half[0].uv = half[0].faces[::2], half[0].uv[::2]
    half[1].faces, half[1].uv, half[1].material, half[1].field = half[1].faces[1::2], half[1].uv[1::2], 1, 1
    two = [Image(picture(*SIZE, 4), CLAMPED), Image(picture(*SIZE, 4, seed=3), CLAMPED)]
    shared = (BASE, Group((ALPHA, BY_NAME["roughness"])))
    return [
        ("maps_every_texels", [("every channel that {} may have", "texels")], ("5.3.1", "5.4.1", "5.7"),
         over_texels(*every_channel(True), (9, 7)), (0, 1)),
        ("maps_every_voxels", [("every channel that {} may have", "voxels")], ("5.3.1", "5.4.1", "5.7"),
         over_voxels(*every_channel(False), 7), (0, 1)),
        ("maps_joint", [("a group of {}", "occlusion + roughness + metallic")], ("5.3.1", "5.7"),
         over_texels([orm], groups("occlusion+roughness+metallic"), models=6), (0, 1, 3)),
        ("maps_joint_order",
         [("groups of {} and of {}", "metallic + occlusion", "roughness"), "groups of maps before base colour"], ("5.3.1", "5.7"),
         over_voxels([orm], [*groups("metallic+occlusion", "roughness")[1:], BASE]), (0, 1)),
        ("maps_joint_partly", ["a group whose channels are those of two materials"], ("5.3.1", "5.4.1"),
         stream_of_parts([Grid(9, constant=False)], [bare(), bare(material=1)], [painted("roughness"), painted("metallic")],
                         groups=groups("roughness+metallic")), (0,)),
        ("maps_with_alpha", [("a group of {}", "alpha + roughness"), "two fields", ("the {} without maps", "second")],
         ("5.3.1", "5.7"), stream_of_parts(two, half, veil, groups=shared), (0, 1)),
        ("maps_grey", [("grey {}", "base_colour"), ("grey {}", "emissive"), ("grey {}", "specular_colour")], ("5.3.1", "7.8.1"),
         over_texels([painted(*greys)], [Group((BASE_COLOUR,), True), *groups(*greys, grey=greys)[1:]], models=6, max_error=0),
         (0, 1)),
        ("maps_some", ["three fields", ("the {} without maps", "third"), "normals over texels and over voxels"], ("5.4.1", "5.7"),
         some_materials(), (0, 1, 2)),
        ("maps_unused", ["a material of no face names a channel that no group holds"], ("5.4.1",),
         over_voxels([Material("seen"), painted("sheen_colour", "normal")], groups(), 9), (0,)),
    ]


def levels_and_values():
    """Clauses 5.4.2, 5.7 and 8.3: coarser planes, constant ones, parameters and effects."""
    rough = groups("occlusion+roughness", "emissive", "metallic")
    named = [painted("occlusion", "roughness", "emissive", "metallic")]
    odd = {(0, 1): 1, (0, 2): 3, (0, 3): 5}
    return [
        ("maps_shift_texels", [("an image of {} x {}", 21, 13), ("level_shift {}", 1), ("level_shift {}", 3),
          ("level_shift {}", 5), "all levels of detail"], ("5.7", "8.3"), over_texels(named, rough, shifts=odd), (*range(6), 9)),
        ("maps_shift_voxels",
         [("K = {}", 13), "all levels of detail", ("level_shift {}", 1), ("level_shift {}", 3), ("level_shift {}", 4)],
         ("5.7", "8.3"), over_voxels(named, rough, shifts={(0, 1): 1, (0, 2): 3, (0, 3): 4}), (*range(5), 9)),
        ("maps_shift_tools", [("K = {}", 29), ("level_shift {}", 2), "lossless", "slices", ("{} models", 8), "colour range"],
         ("5.7", "7.9"),
         over_voxels(named, rough, 29, shifts={(0, 1): 2, (0, 2): 1, (0, 3): 2}, models=8, colour_range=4, slices=FEW,
                     max_error=0), (0, 1, 2, 3)),
        ("maps_shift_planar", [("an image of {} x {}", 45, 31), ("level_shift {}", 1), "a planar support", "rotated splits",
          "a filter", ("{} models", 8)], ("5.7", "5.7.3", "7.11", "7.11.2"),
         filtered_plane(over_texels(named, rough, (45, 31), shifts={(0, 1): 1, (0, 2): 2, (0, 3): 1})), (0, 1, 2)),
        ("maps_constant", ["maps that are constant", ("level_shift {}", 2)], ("5.7", "5.7.6", "8.3"),
         over_texels(named, rough, shifts={(0, 1): 2}, constants=((0, 1), (0, 3))), (0, 1, 2, 3)),
        ("maps_parameters", ["every parameter", "the largest and the least number of binary32"], ("4.3", "5.4.2"),
         over_voxels(every_parameter(), groups(), 9), (0,)),
        ("maps_effects", ["every effect"], ("5.4.1", "5.4.2"),
         over_texels(every_effect(), groups("normal", "occlusion", "clearcoat_normal", "specular"), (9, 7)), (0,)),
        ("maps_unlit", ["no effect", "an unlit material with maps"], ("5.4.1",),
         over_voxels([no_effect()], groups("roughness", "emissive"), 9), (0,)),
    ]


def with_networks():
    """Clauses 5.7.4 and 11: a payload that answers maps as well."""
    named, plain = painted("normal", "roughness", "metallic", "emissive"), Material("plain")
    coded = (*groups("normal_object", "metallic+roughness"), *groups("emissive", grey=("emissive",))[1:])
    small = ring((8, 8))
    both = stream_of_parts([Grid(9), Grid(6)], [bare(small), bare(small, field=1, material=1)], [named, plain], groups=coded)
    quick = {"features": 4, "hidden": (6, 4), "waves": (1, 9)}
    return [
        ("maps_neural", ["3DNTC", "two fields", ("the {} without maps", "second"), ("grey {}", "emissive"), "nine outputs"],
         ("5.3.1", "5.7", "11.1", "11.8"), neural(both, 61, [(5, 0, 0)], **quick), (0, 1)),
    ]


def uncommon():
    """What a decoder meets seldom, and what only another encoder would write."""
    assert len(EFFECTS) == 19 and len(PARAMETERS) == 27  # every_effect(), every_parameter() and their claims
    return channel_groups() + levels_and_values() + with_networks()
