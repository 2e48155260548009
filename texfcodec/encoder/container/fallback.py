"""A glTF file with coded primitives -> the same with an ordinary mesh beside each, for viewers that do not know the streams."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...geometry.geometry_unit import GeometryUnit
from ...io.container.expand import Expansion, stored_attributes
from ...io.container.layout import read_primitives, streams_of
from ...io.container.rewritten import Rewritten
from ...io.formats import AUTO
from ...io.gltf.carried import EXTENSION
from ..fallback import with_fewer_faces

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...io.container.layout import CodedPrimitive
    from ...io.gltf.document import Document
    from ...report import Report
    from ...texf import Texf


class _Fallback(Expansion):
    """One stream of a container, whose primitives and images are kept for viewers that do not know the stream."""

    def _texture(self, entry):
        return entry | {"extensions": {**entry.get("extensions", {}), EXTENSION: {}}}

    def _finish(self, primitive):
        primitive["extensions"][EXTENSION]["fallback"] = True


@np.errstate(all="ignore")  # positions that overflow are refused
def with_fallbacks(document: Document, decode: Callable[[bytes], Texf], report: Report, faces: int | None = None,
                   texture_format: str = AUTO) -> bytes:
    """Return a container in which coded primitives have a fallback: fewer faces, and images of the decoded level of detail.

    Parameters
    ----------
    document : Document
        A container.
    decode : function
        Stream -> Texf.
    report : Report
        Receives a remark for every primitive without fallback: values are stored for the stream's vertices.
    faces : int, optional
        Most faces of all fallbacks together; if None, as few as look the same from afar.
    texture_format : str
        As of SaveOptions.

    Returns
    -------
    bytes
        A GLB. It requires the extension only if a primitive has no fallback.

    Raises
    ------
    InputError, StreamError, LimitError, SupportError
        The file or a stream is at fault.
    """
    out = Rewritten(document)
    streams = [decode(stream) for stream in streams_of(document)]
    primitives = read_primitives(document, [len(texf.units) for texf in streams])
    reasons = [_reason(document, coded, out.root["meshes"][coded.mesh]["primitives"][coded.number]) for coded in primitives]
    report.remarks += [f"primitive {coded.number} of mesh {coded.mesh} has no fallback: {reason}; the file requires {EXTENSION}"
                       for coded, reason in zip(primitives, reasons, strict=True) if reason]
    total = max(sum(len(texf.faces) for texf in streams), 1)
    for number, texf in enumerate(streams):
        simple = [coded for coded, reason in zip(primitives, reasons, strict=True) if coded.stream == number and not reason]
        if simple:
            coarse, simple = _simplified(texf, simple, None if faces is None else faces / total)
            _Fallback(document, out, coarse, simple).write(texture_format)
    if not any(reasons):
        out.require_no_more(EXTENSION)
    return out.glb(deflate=any(reasons))


def _reason(document, coded, primitive):
    """Return what of a primitive is stored for the stream's vertices, which a fallback does not have; "" if it may have one."""
    names = [*stored_attributes(document, coded, primitive), *(["morph targets"] if primitive.get("targets") else [])]
    return f"{', '.join(names)} belong to the vertices of the stream" if names else ""


def _simplified(texf: Texf, primitives: list[CodedPrimitive], share: float | None) -> tuple[Texf, list[CodedPrimitive]]:
    """Return (a Texf with a share of the faces, or as few as look the same, and the primitives with its units).

    Each mesh of the file is simplified by itself: its primitives share borders, and a small one may be seen from near. A
    primitive that has lost all faces keeps its largest.
    """
    units: list[GeometryUnit] = []
    for mesh in dict.fromkeys(coded.mesh for coded in primitives):
        of_mesh = [number for coded in primitives if coded.mesh == mesh for number in coded.units]
        whole = replace(texf, units=[replace(texf.units[number], material=number) for number in of_mesh],  # says where it is from
                        materials=[texf.materials[unit.material] for unit in texf.units])
        count = len(whole.faces) if share is None else max(int(share * len(whole.faces)), 1)
        coarse = with_fewer_faces(whole, count if count < len(whole.faces) else None)
        units += coarse.units
    kept = {unit.material for unit in units}
    units += [_largest_face(texf, coded.units) for coded in primitives if kept.isdisjoint(coded.units)]
    number_of = {unit.material: number for number, unit in enumerate(units)}
    return replace(coarse, units=units), [replace(coded, units=tuple(number_of[n] for n in coded.units if n in number_of))
                                          for coded in primitives]


def _largest_face(texf, units):
    """Return a GeometryUnit of the largest face of some units; its material is the number of its unit."""
    def area(number, face):
        a, b, c = texf.units[number].lattice[face].astype(np.float64)
        return float(np.linalg.norm(np.cross(b - a, c - a)))

    number, face = max(((number, face) for number in units for face in texf.units[number].faces), key=lambda pair: area(*pair))
    unit = texf.units[number]
    return GeometryUnit(unit.field, number, unit.lattice[face], np.arange(3)[None], None if unit.uv is None else unit.uv[face])
