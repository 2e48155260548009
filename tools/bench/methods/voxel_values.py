"""Our own voxels for rivals that code the values in them: the mesh, which voxels it touches and what its textures say there.

Mesh and voxels travel in a stream of ours whose values are all 0, which takes a few bytes: the decoder rebuilds the voxels from
the decoded mesh as ours does, and puts the rival's values in the place of the zeros.
"""

from dataclasses import replace

import numpy as np

from texfcodec.encoder.encode import Encoder
from texfcodec.encoder.write import write
from texfcodec.options import EncodeOptions
from texfcodec.scene.channels import COLOURS, join_planes
from texfcodec.texf import Field
from tools.bench.methods.draco_mesh import positions_alone
from tools.bench.methods.texf import STREAM

PREPARED = {"support": "voxels", "refine": "off", "effects": "none"}


def voxel_values(scene, options, report):
    """Return the encoder's plan of a Scene with base colour and alpha alone in voxels, transferred and not refined. options:
    dict of further EncodeOptions, resolution among them."""
    return Encoder(scene=scene).filled(EncodeOptions(**PREPARED | options), report)


def rgba_of(part):
    """Return the values of a SourceField as they would be coded, uint8 [N, 4], with alpha 255 if it has none."""
    planes = {name: np.clip(np.rint(plane), 0, 255).astype(np.uint8) for name, plane in part.planes.items()}
    return join_planes(planes, len(part.support))


def write_mesh(prepared, folder, report):
    """Write STREAM with values 0 and return (bytes of its positions alone, counted as for texf; all its other bytes)."""
    empty = [part.with_planes({name: np.zeros_like(plane) for name, plane in part.planes.items()}) for part in prepared.fields]
    written = write(replace(prepared, fields=empty), report)
    (folder / STREAM).write_bytes(written.data)
    geometry = min(positions_alone(prepared.surface.lattice, prepared.surface.faces), written.sizes["geometry"])
    return geometry, len(written.data) - geometry


def with_values(parts, rgba):
    """Return Fields with the supports of parts (Fields or SourceFields) and new values, uint8 [N, 4] for each part."""
    fields = []
    for part, values in zip(parts, rgba, strict=True):
        planes = {c.name: np.ascontiguousarray(values[:, list(c.columns)]) for c in COLOURS if c.name in part.planes}
        fields.append(Field(part.support, planes))
    return fields
