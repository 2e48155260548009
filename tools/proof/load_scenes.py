"""Small scenes of different kinds, each with what it is coded with: what tools/proof/load.py does again and again."""

import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY / "tests") not in sys.path:
    sys.path.append(str(REPOSITORY / "tests"))


def small_scenes():
    """{kind: (Scene, EncodeOptions without threads)}."""
    from shapes import crossing_sheets, mapped_sheet, noise, painted_sphere, plain_image

    from texfcodec.options import EncodeOptions

    maps = {"normal": plain_image(140, 120, 250), "roughness": noise(3), "occlusion": noise(4)}
    made = {
        "vertex colours": (painted_sphere(6), {"resolution": 32, "qp": 24}),
        "two materials, alpha": (crossing_sheets(), {"resolution": 24, "qp": 30}),
        "texels": (crossing_sheets(), {"support": "texels", "resolution": 24, "qp": 30}),
        "maps": (mapped_sheet(maps), {"resolution": 24, "qp": 30}),
        "lossless": (painted_sphere(5), {"resolution": 20, "lossless": True}),
        "fast": (painted_sphere(4), {"resolution": 48, "qp": 34, "effort": "fast"}),
        "3dntc": (painted_sphere(4), {"codec": "3dntc", "resolution": 16, "steps": 8, "point": "mpeg1"}),
    }
    return {kind: (scene, EncodeOptions(threads=2, **options)) for kind, (scene, options) in made.items()}
