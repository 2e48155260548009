"""The rival of materials.py: one Draco mesh with UVs, normals, TANGENTs and vertex colours, and every map as AVIF.

Draco codes normals as octahedra and TANGENTs as a generic attribute of four components, as glTF-Transform has them coded, at any
of the bits below; a rival without TANGENTs has viewers make them. Pictures are of what comes back: positions on Draco's lattice,
rounded UVs, normals, tangents and colours; UVs of 12 bits alone would end at 39 dB on the fan and at 27
on the cloth, whose image repeats. Where a file's TANGENTs turn green over, the rival's maps are turned back first, or it could
not leave TANGENTs out. The GLB's own JSON is not counted. Records but the cloth's were made before UVs of 16 bits were a choice.
"""

import io
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from texfcodec.encoder.values.shown_maps import SAME_FRAME, turn_of
from texfcodec.scene.channels import BY_NAME, channel_over
from texfcodec.scene.scene import Scene
from tools.bench.everyday_rivals import (
    TEXTURED_COLOUR_BITS,
    CornerFrames,
    dec_image,
    dequantise_tangent,
    dequantise_uv,
    draco_bytes,
    octahedral,
    quantise_colour,
    quantise_tangent,
    quantise_uv,
    rival_of,
    shrunk,
)

SCALES = {1: (25, 50, 75, 93), 2: (20, 60)}  # the records of smaller sets have more of both
UV_BITS, NORMAL_BITS, TANGENT_BITS, SPEED = (12, 14, 16), (8, 10), (8, 10), 6
WORTH = 0.2  # dB that a larger mesh must be better by, with the source's maps, to be looked at with others
SAME_PICTURE = 60  # dB


@dataclass
class LitMesh:
    """What one choice of bits makes of a mesh. scene: with the source's maps; bits: of its attributes, by name; bytes: of
    positions and what each attribute adds, by name; coded: what draco_bytes() was given."""

    scene: Scene
    bits: dict
    bytes: dict
    coded: dict

    @property
    def size(self):
        """Draco's bytes."""
        return sum(self.bytes.values())


def rival_record(looked):
    """The curves of the rival: {"asset", "positions": bytes, "meshes", "points", "maps"}. looked: as materials.py has it."""
    looked = looked.of(upright(looked))
    rival = rival_of(looked.scene)
    meshes, told = worth_looking(looked, lit_meshes(rival, looked.needed.materials))
    shown = {t for t, key in enumerate(rival.content) if key in rival.with_alpha}
    used = sorted({texture for _, _, texture in looked.maps()})
    points, maps, full = [], {}, set()
    for scale, quality in ((scale, quality) for scale, qualities in SCALES.items() for quality in qualities):
        setting = {"scale": scale, "quality": quality}
        coded = {t: coded_avif(looked, t, scale, quality, t in shown, (t, scale) in full) for t in used}
        full |= {(t, scale) for t, (_, _, subsampling) in coded.items() if subsampling == "4:4:4"}
        psnr = looked.map_psnr({(number, name): coded[t][0] for number, name, t in looked.maps()})
        for t in used:
            mine = list(dict.fromkeys(name for _, name, texture in looked.maps() if texture == t))
            maps.setdefault(" + ".join(mine), []).append(setting | {"bytes": coded[t][1]} | {n: psnr[n] for n in mine})
        textures = [replace(x, image=coded[t][0]) if t in coded else x for t, x in enumerate(looked.scene.textures)]
        size = sum(size for _, size, _ in coded.values())
        for mesh in meshes:
            points.append(setting | mesh.bits | {"map_bytes": size, "total": mesh.size + size}
                          | looked.psnr(replace(mesh.scene, textures=textures)))
            print(looked.name, points[-1], flush=True)
    return {"asset": looked.name, "positions": meshes[0].bytes["positions"], "meshes": told, "points": points, "maps": maps}


# The mesh.


def upright(looked):
    """The Scene whose normal maps stand in the frame that viewers make of UVs, its TANGENTs' hands with them, where that shows
    the same picture; else the Scene as it is."""
    scene, surface = looked.scene, looked.surface
    users = {}
    for number, material in enumerate(scene.materials):
        for name, texture in material.maps.items():
            if BY_NAME[name].unit == "degrees":
                users.setdefault(texture, set()).add(number)
    turns = {n: turn_of(scene, surface, np.flatnonzero(surface.material == n)) for n in set().union(*users.values(), ())}
    over = {n for n, turn in turns.items() if turn is not None and np.abs(turn - np.diag([1, -1])).max() <= SAME_FRAME}
    mine = [t for t, numbers in users.items() if numbers <= over]
    if not mine or any(numbers & over and not numbers <= over for numbers in users.values()):
        return scene
    tangent, textures = scene.corner_tangent.copy(), list(scene.textures)
    tangent[np.isin(scene.face_material, list(over)), :, 3] *= -1
    for t in mine:
        image = textures[t].image.copy()
        image[..., 1] = 255 - image[..., 1]
        textures[t] = replace(textures[t], image=image)
    made = replace(scene, corner_tangent=tangent, textures=textures)
    seen = looked.psnr(made)["psnr_y"]
    return made if seen is None or seen > SAME_PICTURE else scene


def lit_meshes(rival, materials):
    """The LitMesh of every choice of bits. materials: without maps that are not coded."""
    scene, rival = replace(rival.scene, materials=materials), with_maps_in_view(rival)
    bare = {"uv": None, "colour": None, "frames": None}
    mesh = LitMesh(replace(scene, corner_tangent=None), {}, {"positions": draco_bytes(rival, **bare)}, bare)
    meshes = [_with(rival, mesh, "uv", bits, {"uv": (steps, bits)}, corner_uv=dequantise_uv(rival, steps, bits))
              for bits in UV_BITS for steps in [quantise_uv(rival, bits)]]
    if rival.is_coloured:
        meshes = [_with(rival, mesh, "colour", bits, {"colour": steps},
                        corner_color=(steps / ((1 << bits) - 1)).astype(np.float32))
                  for mesh in meshes for bits in TEXTURED_COLOUR_BITS for steps in [quantise_colour(rival, bits)]]
    if scene.corner_normal is not None:
        meshes = [_with(rival, mesh, "normal", bits, {"frames": CornerFrames(normal, bits)}, corner_normal=normal)
                  for bits in NORMAL_BITS for normal in [octahedral(scene.corner_normal, bits)] for mesh in meshes]
        if scene.corner_tangent is not None:
            meshes += [_with(rival, mesh, "tangent", bits, {"frames": replace(mesh.coded["frames"], tangent=steps)},
                             corner_tangent=dequantise_tangent(steps, bits))
                       for bits in TANGENT_BITS for steps in [quantise_tangent(scene.corner_tangent, bits)] for mesh in meshes]
    return meshes


def _with(rival, mesh, part, bits, coded, **looks):
    """A LitMesh with one more attribute. coded, looks: what draco_bytes() and the scene get of it."""
    coded = mesh.coded | coded
    added = draco_bytes(rival, **coded) - mesh.size
    return LitMesh(replace(mesh.scene, **looks), mesh.bits | {f"{part}_bits": bits}, mesh.bytes | {part: added}, coded)


def with_maps_in_view(rival):
    """A Rival whose UVs are rounded on materials that have maps and no base colour too."""
    materials = [replace(m, texture=max(m.texture, *m.maps.values(), -1)) if m.maps else m for m in rival.scene.materials]
    return replace(rival, scene=replace(rival.scene, materials=materials))


def worth_looking(looked, meshes):
    """(the meshes that no smaller one comes near, what is told of all): by pictures with the source's maps."""
    kept, told, best = [], [], -np.inf
    for mesh in sorted(meshes, key=lambda mesh: mesh.size):
        seen = looked.psnr(mesh.scene)
        told.append(mesh.bits | {"bytes": mesh.bytes, "total": mesh.size} | seen)
        print(looked.name, told[-1], flush=True)
        quality = np.inf if seen["psnr_y"] is None else seen["psnr_y"]
        if quality > best + WORTH:
            kept, best = [*kept, mesh], quality
    return kept, told


# The maps.


def _columns(looked, texture, alpha):
    """Columns of an image that anything asks."""
    names = {name for _, name, t in looked.maps() if t == texture}
    normal = any(BY_NAME[name].unit == "degrees" for name in names)
    asked = {0, 1, 2} if normal else {c for name in names for c in channel_over(name, True).columns}
    return sorted(asked | ({3} if alpha else set()))


def coded_avif(looked, texture, scale, quality, alpha=False, full=False):
    """(decoded uint8 [H, W, 4], bytes, subsampling) at the better of both subsamplings: the smaller one at the same quality
    setting is kept where it loses no more than it saves. Columns that nothing asks are flat; one alone is grey. alpha: whether
    alpha is seen; full: that 4:4:4 was better at a lower quality already, so that nothing else is tried."""
    image, columns = looked.scene.textures[texture].image, _columns(looked, texture, alpha)
    kept = image.copy()
    kept[..., [c for c in (0, 1, 2) if c not in columns]] = 0
    if len(columns) == 1 and 3 not in columns:
        kept[..., :3] = image[..., columns]
    size = image.shape[1::-1]
    small = kept if scale == 1 else resized(kept, [max(1, round(side / scale)) for side in size], Image.Resampling.LANCZOS)
    picture, best = shrunk(small, 1, 3 in columns), None
    for subsampling in ("4:0:0",) if picture.mode == "L" else ("4:2:0", "4:4:4")[full:]:
        out = io.BytesIO()
        picture.save(out, "AVIF", quality=quality, speed=SPEED, subsampling=subsampling, max_threads=looked.threads)
        decoded = dec_image(out.getvalue())
        if scale > 1:
            decoded = resized(decoded, size, Image.Resampling.BICUBIC)
        error = float(((decoded[..., columns].astype(np.float32) - image[..., columns]) ** 2).mean())
        cost = len(out.getvalue()) * max(error, 1e-3) ** 0.8
        if best is None or cost < best[0]:
            best = cost, decoded, len(out.getvalue()), subsampling
    return best[1:]


def resized(image, size, kernel):
    """uint8 [H, W, 4] at a size (width, height). Alpha, which may be data, goes apart: Pillow weighs colours by it."""
    parts = (Image.fromarray(np.ascontiguousarray(image[..., part])).resize(size, kernel) for part in (slice(3), 3))
    return np.dstack([np.asarray(part) for part in parts])
