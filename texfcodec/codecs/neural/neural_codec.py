"""3DNTC as a codec of the registry (codec_id 1, spec clauses 5.7.4 and 11)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ...core.syntax_walk import Reader, read_structure, write_structure
from ...errors import InputError, StreamError
from ...limits import Limits
from ..base import PROFILES, Evaluator, Group, Joint, JointCodec, Source
from .neural_options import NeuralOptions
from .neural_syntax import FORM_RESIDENT, FORM_TRANSPORT, LATENT_LEVEL, NEURAL

if TYPE_CHECKING:
    from ...geometry.geometry_unit import LatticeMesh
    from ...options import DecodeOptions, EncodeOptions
    from ...report import Report


class Neural(JointCodec):
    """INT4 latents and a small network that answer any surface point; fitted by training, kept on a GPU."""

    id, name = 1, "3dntc"
    purpose = "trains latents and a network that a renderer can query at any point"
    structures = (NEURAL, LATENT_LEVEL)
    options = frozenset({"point", "resident_bytes", "latent_index", "transport", "steps", "seed", "checkpoint", "fit_engine"})
    position_bits = 16  # a payload of 50 dB shows what 14 do to a picture: bottle 45.6 dB over 4 views, 50.1 with exact geometry
    checksum_clause = "11.8"
    settings_type = NeuralOptions
    small = ({"resolution": 16, "resident_bytes": 40_000, "steps": 2, "transport": True, "fit_engine": "numba"},)

    def check_options(self, options: EncodeOptions) -> None:
        """Raise InputError TXF-I50 for refine "fit", and for point, resident_bytes and latent_index that contradict each
        other."""
        if options.refine == "fit":
            raise InputError("TXF-I50", "refine fit does not apply to codec 3dntc; choose auto, off or "
                                        "render", value=options.refine)
        if options.point and options.resident_bytes:
            raise InputError("TXF-I50", "point and resident_bytes cannot be combined", value=options.point)
        if options.resident_bytes and options.latent_index == "hash":
            raise InputError("TXF-I50", "resident_bytes requires latent_index mixed or surface; hash requires a point",
                             value=options.resident_bytes)

    def profile(self, values: dict) -> str:
        """Return the profile of streams whose fields are latents and a network: "neural"."""
        return PROFILES[2]

    def seconds(self, options: EncodeOptions) -> float:
        """Return the estimated seconds of the fit, by its steps, with two threads."""
        return options.steps * 6e-3

    def enc(self, source: Source, options: NeuralOptions, report: Report) -> Joint:
        """Fit latents and a network to the source and return the Joint; its choices are "resident" (bytes on the GPU), "fit"
        (the log) and "refinement"."""
        from .fit_payload import fit_payload
        from .payload import payload_values

        payload, tables, choices = fit_payload(source, options, report)
        return Joint(payload_values(payload, FORM_TRANSPORT if options.transport else FORM_RESIDENT), tables, choices)

    def count_samples(self, values: dict, surfaces: list[LatticeMesh], position_bits: int) -> int:
        """Return the number of surface samples by which dec() derives the voxels that have latents (11.3)."""
        from ...field.voxelise import count_samples

        grids = [level["level_resolution"] for level in values["latent_levels"] if level["table_log2"] == 0]
        return sum(count_samples(lattice, faces, position_bits, grid) for lattice, faces in surfaces for grid in grids)

    def count_latents(self, values: dict) -> int:
        """Return the number of latents in the unit: rows of all levels times latents per row."""
        return sum(level["NumRows"] for level in values["latent_levels"]) * values["num_features"]

    def dec(self, values: dict, surfaces: list[LatticeMesh], position_bits: int, groups: tuple[Group, ...],
            options: DecodeOptions, report: Report) -> list[Evaluator]:
        """Derive the voxels of the latents from the surfaces, unpack the latents and return payload.Tables by field."""
        from .payload import Tables, payload_of, take_codes

        payload = payload_of(values, options.limits)
        with report.stage("voxelise"):
            grids = [[_level_voxels(surface, position_bits, level, i, options) for level in payload.levels]
                     for i, surface in enumerate(surfaces)]
        with report.stage("attributes"):
            take_codes(payload, values)
            return [Tables(payload, i, keys) for i, keys in enumerate(grids)]

    def check(self, values: dict) -> None:
        """Checks the relations of clause 5.7.4."""
        if values["num_features"] % 2:
            raise StreamError("TXF-S04", "num_features is odd", clause="5.7.4", offset=values["offset"],
                              value=values["num_features"], allowed="even")
        length = sum(level["NumRows"] for level in values["latent_levels"]) * values["num_features"] // 2
        if values["form"] == FORM_RESIDENT and len(values["latent_data"]) != length:
            raise StreamError("TXF-S10", "the latents do not fill the payload", clause="5.7.4", offset=values["offset"],
                              value=len(values["latent_data"]), allowed=length)

    def describe(self, values: dict) -> dict:
        """Return {"neural": form, levels, widths, and the bytes on a GPU without the index, which the geometry gives}."""
        rows = [level["NumRows"] for level in values["latent_levels"]]
        neural = {"form": "transport" if values["form"] == FORM_TRANSPORT else "resident", "features": values["num_features"],
                  "levels": [{"resolution": level["level_resolution"], "table_log2": level["table_log2"], "rows": n}
                             for level, n in zip(values["latent_levels"], rows, strict=True)],
                  "widths": values["Widths"], "latent_bytes": sum(rows) * values["num_features"] // 2,
                  "network_bytes": values["ParameterBytes"]}
        return {"neural": neural}

    def info_lines(self, group: dict) -> Iterator[str]:
        """Yield the line of texf-info: bytes, levels of latents, widths of the network. group: an entry of inspect()'s
        groups."""
        neural = group["neural"]
        levels = ", ".join(f"{level['rows']} rows at {level['resolution']}" + (" (hashed)" if level["table_log2"] else "")
                           for level in neural["levels"])
        yield (f"3DNTC, all fields: {group['bytes']} bytes, {neural['form']} form; {levels} of {neural['features']} latents; "
               "network " + "-".join(map(str, neural["widths"]))
               + f"; on a GPU {neural['latent_bytes'] + neural['network_bytes']} bytes and an index")

    def pack(self, evaluators: list) -> tuple[dict, dict]:
        """Return ({}, arrays): "neural", bytes of neural_parameters in the resident form, and "latent_keys", Morton keys of the
        voxels of all levels that are not hashed."""
        from .payload import payload_values

        payload = evaluators[0].payload
        values = payload_values(payload, FORM_RESIDENT) | {"num_fields": len(evaluators), "NumOutputs": payload.components}
        keys = [k for tables in evaluators for k in tables.keys if k is not None]
        return {}, {"neural": np.frombuffer(write_structure(NEURAL, values), np.uint8),
                    "latent_keys": np.concatenate([np.zeros(0, np.int64), *keys])}

    def unpack(self, facts: dict, arrays: dict, groups: tuple[Group, ...], fields: int) -> list[Evaluator]:
        """Rebuild payload.Tables by field from the arrays of pack(); the payload is checked as in a stream."""
        from .payload import Tables, payload_of, take_codes

        data = np.ascontiguousarray(arrays["neural"], np.uint8).tobytes()
        values = {"num_fields": fields, "NumOutputs": sum(group.components for group in groups), "offset": 0}
        read_structure(NEURAL, Reader(data, 0, len(data)), values)
        self.check(values)
        if values["form"] != FORM_RESIDENT:
            raise ValueError("form")
        payload = payload_of(values, Limits(latents=None))
        grids = _split_keys(payload, arrays["latent_keys"], fields)
        take_codes(payload, values)
        return [Tables(payload, number, keys) for number, keys in enumerate(grids)]

    def result_lines(self, facts: dict) -> Iterator[str]:
        """Yield the lines of texf-enc: bytes on a GPU, then steps, seconds and PSNR of the fit. facts: the document of
        --json."""
        from ...core.colour_error import in_decibels

        kept, fit, refinement = facts["resident"], facts["fit"], facts["refinement"]
        grids = ", ".join(f"{level['rows']} rows of a grid of {level['resolution']}" for level in fit["levels"])
        yield (f"resident {kept['total']} bytes: latents {kept['latents']} ({grids}), network {kept['network']}, "
               f"index {kept['index']}; {facts['fields']} field" + ("s" if facts["fields"] != 1 else ""))
        early = "" if fit["steps"] == fit["asked_steps"] else f" of {fit['asked_steps']}, stopped without further gain"
        yield (f"fit: {fit['steps']} steps{early}, {fit['seconds']:.0f} s, RGB {in_decibels(fit['psnr_rgb'])} at held-out points")
        others = [f"{name} {in_decibels(psnr)}" for name, psnr in fit["psnr_channels"].items()][1:]
        if others:
            yield "maps at held-out points, in 0 to 255: " + ", ".join(others)
        if refinement["kind"] == "render":
            psnr = {row["iteration"]: row["held_out_psnr"] for row in refinement["iterations"]}
            shown = [in_decibels(psnr[n]) for n in (0, refinement["kept_iteration"])]
            yield (f"refined on pictures: {shown[0]} to {shown[1]} in held-out views; "
                   f"{refinement['psnr_rgb']:.2f} dB at the points")
        elif refinement["asked"] == "render":
            yield f"not refined on pictures: {refinement['reason']}"


def _level_voxels(surface, position_bits, level, number, options):
    """Voxels of one field that have latents, ascending Morton keys; None for a hashed level (clause 11.3)."""
    from ...field.voxelise import voxelise

    if level.table_log2:
        return None
    lattice, faces = surface
    keys, _ = voxelise(lattice, faces, position_bits, level.resolution, level.area_threshold, options.threads,
                       options.limits.voxels)
    if len(keys) != level.entries[number]:
        raise StreamError("TXF-S30", "the voxels rebuilt from the geometry differ from those that have latents", clause="11.3",
                          value=len(keys), allowed=level.entries[number])
    return keys


def _split_keys(payload, joined, fields):
    """Splits an array of latents' voxels by field and level. Raises ValueError for an invalid array."""
    from ...field.voxels import keys_are_sound

    at = 0
    grids: list[list[np.ndarray | None]] = []
    for number in range(fields):
        grids.append([])
        for level in payload.levels:
            count = 0 if level.table_log2 else level.entries[number]
            part = np.ascontiguousarray(joined[at : at + count], np.int64)
            if count and not (len(part) == count and keys_are_sound(part, level.resolution)):
                raise ValueError("latent_keys")
            grids[-1].append(part if count else None)
            at += count
    return grids
