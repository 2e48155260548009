"""Compiling the kernels ahead of use, and telling without numba whether that has been done."""

import sys
from pathlib import Path

from .ground.kernel import PACKAGE, cache_folder

# Every encode and decode enters kernels of the first file, those of the usual efforts enter kernels of the second
ENTRIES = ("support/voxelise.py", "codecs/raht/coefficients/mixed.py")


def kernels_compiled():
    """Whether the cache holds kernels of every file of ENTRIES as it stands, for this interpreter."""
    tag = f"py{sys.version_info.major}{sys.version_info.minor}"
    return all(any(cache_folder(PACKAGE / entry).glob(f"*/{Path(entry).stem}.*.{tag}*.nbi")) for entry in ENTRIES)


def warm_up():
    """Encodes, measures, decodes, renders, bakes and saves a small mesh, so that every kernel is compiled and cached."""
    import tempfile

    from .decoder import decode
    from .encoder import encode_scene
    from .options import EncodeOptions
    from .quality.measure import measure
    from .quality.views import compare_views
    from .report import Report

    scene, report = small_scene(), Report()
    data, _ = encode_scene(scene, EncodeOptions(resolution=64, qp=20), report)
    for other in (EncodeOptions(resolution=16, max_error=0), EncodeOptions(resolution=16, effort="fast")):
        decode(encode_scene(scene, other)[0])
    neural = EncodeOptions(codec="3dntc", resolution=16, resident_bytes=40_000, steps=2, transport=True, fit_engine="numba")
    decode(encode_scene(scene, neural)[0])
    texf = decode(data)
    measure(scene, texf, 1000, face_field=report.facts.get("scene_face_field"))
    compare_views(scene, texf, views=1, size=64, ssim=True)
    with tempfile.TemporaryDirectory() as folder:
        for atlas in ("fast", "quality"):
            texf.save(Path(folder) / "a.glb", texture_size=64, atlas=atlas)


def small_scene():
    """Two crossing sheets, one of them see-through, so that fields split and both channel groups are coded."""
    import numpy as np

    from .asset.scene import ALPHA_BLEND, Material, Scene, Texture

    side = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    flat, upright = np.insert(side, 2, 0.5, axis=1), np.insert(side, 0, 0.5, axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    image = np.random.default_rng(0).integers(0, 256, (16, 16, 4), np.uint8)
    return Scene(
        positions=np.concatenate([flat, upright]), faces=np.concatenate([faces, faces + 4]),
        face_material=np.array([0, 0, 1, 1]), corner_uv=np.concatenate([side[faces], side[faces]]), corner_color=None,
        materials=[Material(texture=0), Material(texture=0, alpha_mode=ALPHA_BLEND)], textures=[Texture(image)],
    )
