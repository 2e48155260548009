"""The encoder's check of its own stream: the stream is read again and compared with its source, part by part and in small
pictures.

The check decodes container, geometry, places of values and their checksums from the bytes. Decoding the values themselves takes a
tenth to a quarter of the time of coding them, so the check decodes as many units as a share of that time allows. The other units
get the values that the encoder has from its own mirror of the decoder.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..core.colour_error import decibels
from ..decoder import decode_stream
from ..errors import InputError, LimitError
from ..limits import UNLIMITED
from ..metrics.parts import compare_parts
from ..metrics.views import ViewSettings, compare_views
from ..options import RATES, DecodeOptions
from ..render.environment import DAYLIGHT
from ..report import Report, Step, no_step
from .caches import Caches
from .encode import Encoder, encode_scene
from .prepare.uniform_colour import NOTHING_TO_PROBE
from .price import coding_mse
from .values.coder import LAST_QP
from .values.unit_qp import BITS_PER_QP
from .write import write

if TYPE_CHECKING:
    from ..options import EncodeOptions
    from ..scene.scene import Scene
    from .write import Encoded

VIEWS, SIZE = 4, 160
SHARE = 0.05  # of the time an encode took, for decoding its values again
SECONDS_PER_VALUE = 6e-7  # of a decoder, with one thread, at most: 1.0 to 2.6 million values a second
# Bytes that parts may add which are coded again, finer: of the first stream's so much for their share of the surface, and at most
# so much. A city's billboards, 400 voxels of it, would have added 36 %.
MORE_PER_SHARE, MOST_MORE = 10.0, 0.5
SURE_SHARE = 0.8  # of the bytes that a finer QP is expected to add
MOST_TRIES = 5  # coarser QPs, until a stream is no larger than its source
LEAST_GAIN = 1.0  # dB that the worst part must gain by it
FINER_CHROMA = 6  # QP
# dB under what the rate promises from which Y, or RGB and alpha, or pictures with their outlines count as a miss
SHORTFALL, COLOUR_SHORTFALL, OUTLINE_SHORTFALL = 4.5, 10.0, 15.0


@dataclass(frozen=True, kw_only=True)
class Miss:
    """A part that is worse than the rate promises. material: its number; name: of the material; share: of the surface; measure:
    "Y" or "RGB"; psnr: in dB."""

    material: int
    name: str
    share: float
    measure: str
    psnr: float

    def __str__(self) -> str:
        return f"'{self.name}' has {self.psnr:.1f} dB ({self.measure})"


def encode_checked(scene: Scene, options: EncodeOptions, report: Report) -> Encoded:
    """Code a scene, check the stream, and code parts again that are worse than the rate promises.

    Parts are coded again, finer, if that is possible at a moderate cost. Parts that stay worse become warnings.

    Parameters
    ----------
    scene, options : Scene, EncodeOptions
        The source, and settings without a target.
    report : Report
        Receives seconds by stage, and the messages of the stream that is kept.

    Returns
    -------
    Encoded
        The stream and its report, with the result of check_encoded(). Raises as encode_scene().
    """
    begin, kept = time.perf_counter(), Report(report.on_progress)
    may_try_again = options.support == "auto" and promised_psnr(options) is not None
    encoder = Encoder(scene=scene, caches=Caches.of_second_try() if may_try_again else Caches())
    filled = encoder.filled(options, kept)
    encoded = write(filled, kept, encoder.caches.units)
    if len(encoded.data) > sum(scene.files.values()) > 0:
        encoded, kept = _no_larger(scene, encoded, options, kept)
    checked = check(scene, encoded, options, kept, time.perf_counter() - begin)
    missed = misses(checked)
    if missed and _may_be_finer(encoded, missed, options, scene):
        most = _most_bytes(encoded, missed, scene)
        for again, second in _tries(encoder, filled, encoded, options, kept):
            is_better = again is not None and len(again.data) <= most and _is_better(again.check, checked)
            if is_better:
                second.remarks.append(f"{_named(missed)} and was coded again at higher quality, in {len(again.data)} bytes "
                                      f"instead of {len(encoded.data)}")
                encoded, checked, kept, second = again, again.check, second, kept
            report.take_seconds(second)
            if is_better or (again is not None and len(again.data) > most):
                break
    report.take(kept)
    report.warnings += warnings_of(checked, options)
    return encoded


def _tries(encoder, filled, first, options, kept):
    """Yield (checked Encoded with finer values of the missed parts, or None; its Report): of the first one's fields where their
    QP may be all that is too coarse, then of finer supports. filled, kept: Filled and Report of the first."""
    missed = misses(first.check)
    if _needs_no_other_support(first, missed):
        report = Report(kept.on_progress)
        report.take_sentences(kept)
        yield _coded_at_no_offset(filled, missed, options, report, encoder.caches.units), report
    report = Report(kept.on_progress)
    yield _coded_finer(encoder, missed, options, report), report


def _no_larger(scene, encoded, options, report):
    """Return (Encoded, its report), at a coarser QP if the stream is larger than the source's files and the encoder may choose
    the quality; unchanged if no QP helps."""
    most, is_free = sum(scene.files.values()), promised_psnr(options) is not None and options.given["qp"] is None
    if not is_free or encoded.sizes["attributes"] < len(encoded.data) - most:
        return encoded, report
    qp, best, kept = options.qp, encoded, report
    for _ in range(MOST_TRIES):
        values = max(most - len(best.data) + best.sizes["attributes"], 1)
        qp += 1 + math.ceil(math.log2(best.sizes["attributes"] / values) / BITS_PER_QP)
        if qp > LAST_QP:
            return encoded, report
        kept = Report(report.on_progress)
        best = encode_scene(scene, options.changed(qp=qp), kept)
        report.take_seconds(kept)
        if len(best.data) <= most:
            kept.remarks.append(f"coded at QP {qp} instead of {options.qp}, so that the stream is not larger than its source")
            return best, kept
    return encoded, report


def _coded_finer(encoder, missed, options, report):
    """Return the checked Encoded with finer supports for the missed parts; None if these go over a limit that the first encode
    kept."""
    begin, materials = time.perf_counter(), frozenset(miss.material for miss in missed)
    try:
        encoded = encoder.encode(_finer(options, missed), report, materials)
    except LimitError:
        return None
    check(encoder.scene, encoded, options, report, time.perf_counter() - begin)
    return encoded


def _needs_no_other_support(encoded, missed):
    """Return whether all missed parts are over as many texels as their images have, at a QP coarser than the rate's."""
    groups = encoded.choices["supports"]["groups"]
    behind = {part: group for group in groups for part in group["materials"]}
    own = [behind.get(miss.material, {}) for miss in missed]
    return all(miss.measure == "Y" for miss in missed) and all(
        group.get("chosen") == "texels" and group["size"] == group["image"] and group.get("texels", {}).get("qp_offset", 0) > 0
        for group in own)


def _coded_at_no_offset(filled, missed, options, report, units):
    """Return the checked Encoded of a Filled in which the fields of the missed parts have the rate's QP."""
    begin, source = time.perf_counter(), filled.source
    missing = np.isin(source.surface.material, [miss.material for miss in missed])
    worse = set(source.face_field[missing].tolist())
    fields = [replace(part, qp_offset=min(part.qp_offset, 0)) if number in worse else part
              for number, part in enumerate(filled.fields)]
    encoded = write(replace(filled, fields=fields), report, units)
    check(source.scene, encoded, options, report, time.perf_counter() - begin)
    return encoded


def _may_be_finer(encoded, missed, options, scene):
    """Return whether the encoder may code parts finer, and whether they may fit into the bytes allowed."""
    if options.support != "auto" or options.qp != encoded.qp:
        return False
    parts, more = {miss.material for miss in missed}, 0
    for group in encoded.choices["supports"]["groups"]:
        if not parts & set(group["materials"]) or "texels" not in group:
            continue
        texels = group["texels"]["attribute_bytes"]
        if group["chosen"] == "voxels":
            more += texels - group["voxels"]["attribute_bytes"]
        more += SURE_SHARE * texels * (2 ** (BITS_PER_QP * max(group["texels"]["qp_offset"], 0)) - 1)
    return len(encoded.data) + more <= _most_bytes(encoded, missed, scene)


def _most_bytes(encoded, missed, scene):
    """Return the bytes that a stream with finer parts may have: no more than the source, unless the stream already has more."""
    most = len(encoded.data) * (1 + min(MORE_PER_SHARE * sum(miss.share for miss in missed), MOST_MORE))
    source = sum(scene.files.values()) or math.inf
    return min(most, max(source, len(encoded.data)))


def _finer(options, missed):
    """Return the options, with finer chroma if a part misses in colour."""
    if all(miss.measure == "Y" for miss in missed):
        return options
    usual = -1 if options.chroma_qp_offset is None else options.chroma_qp_offset
    return options.changed(chroma_qp_offset=max(usual - FINER_CHROMA, -63))


def _is_better(again, first):
    """Return whether the worst part gained enough between two checks."""
    before, after = (min((miss.psnr for miss in misses(check_of)), default=None) for check_of in (first, again))
    return after is None or (before is not None and after >= before + LEAST_GAIN)


def check(scene: Scene, encoded: Encoded, options: EncodeOptions, report: Report, seconds: float) -> dict:
    """Return the result of check_encoded() and store it in encoded.check. The decoded values in encoded.values, which only the
    check needs, are dropped. seconds: duration of the encode."""
    with report.stage("check") as step:
        checked = encoded.check = check_encoded(scene, encoded, options, seconds, step)
    encoded.values = []
    return checked


def check_encoded(scene: Scene, encoded: Encoded, options: EncodeOptions, seconds: float, step: Step = no_step) -> dict:
    """Decode a stream and compare it with the Scene that it was encoded from, part by part and in small pictures.

    Parameters
    ----------
    scene, encoded : Scene, Encoded
        The source, and its stream with the values of the encoder.
    options : EncodeOptions
        As they were for the encode.
    seconds : float
        Duration of the encode, a share of which may go into decoding values again.
    step : function, optional
        Of Report.stage(), called with the progress of the check.

    Returns
    -------
    dict
        JSON-ready: the result of compare_parts(), with None for each PSNR if nothing is visible; "worst": the part with the
        least PSNR of RGB, None if all are exact; "lit" or "flat": PSNR of Y in small pictures, with light if the asset is lit;
        "outline": the same over pixels that either side covers; neither of these if one colour, with normals that follow from
        the geometry, leaves nothing to compare; "promised": PSNR of Y that the rate promises, None if it promises none;
        "decoded_units": (units whose values were decoded, all units).

    Raises
    ------
    StreamError
        The stream does not hold what the encoder put into it.
    """
    texf, decoded = _decoded(encoded, options, seconds)
    step(1, 3)
    compared = compare_parts(scene, texf, options.threads) if len(texf.faces) else None
    step(2, 3)
    known = {"promised": promised_psnr(options), "decoded_units": decoded}
    if compared is None:
        return {"y": None, "rgb": None, "parts": [], "visible": False, "worst": None, **known}
    inexact = [part for part in compared["parts"] if part["rgb"] is not None]
    worst = min(inexact, key=lambda part: part["rgb"], default=None)
    is_geometry_alone = scene.corner_normal is None and encoded.choices["supports"].get("reason") == NOTHING_TO_PROBE
    seen = {} if is_geometry_alone else _seen(scene, texf, options)  # which has its own checksum
    return {**compared, "visible": True, "worst": worst, **seen, **known}


def promised_psnr(options: EncodeOptions) -> float | None:
    """Return the PSNR of Y, in dB, that the options' rate promises; None with a target, or if the encoder may not choose K and
    supports."""
    free = options.rate_is_free and options.target_bytes is None and options.target_psnr is None
    return round(decibels(coding_mse(options.reckoned_qp)), 2) if free and options.qp is not None else None


def misses(check: dict) -> list[Miss]:
    """Return the parts of the scene whose PSNR falls short of the promised one by more than SHORTFALL or COLOUR_SHORTFALL, the
    worst first. check: result of check_encoded()."""
    if check["promised"] is None:
        return []
    missed = []
    for part in check["parts"]:
        for measure, name, shortfall in (("y", "Y", SHORTFALL), ("rgb", "RGB", COLOUR_SHORTFALL)):
            if part[measure] is not None and part[measure] < check["promised"] - shortfall:
                missed.append(Miss(material=part["material"], name=part["name"], share=part["share"], measure=name,
                                  psnr=part[measure]))
                break
    return sorted(missed, key=lambda miss: miss.psnr)


def warnings_of(check: dict, options: EncodeOptions) -> list[str]:
    """Return sentences on everything that is worse than the rate promises. check: of check_encoded(); options: of the encode."""
    missed, rate = misses(check), f"{options.rate} promises {check['promised']:.0f} dB" if check["promised"] else ""
    said = []
    if not check["visible"]:
        said.append("no part of the source's surface is visible, so its colours could not be compared")
    if missed:
        said.append(f"{_named(missed)}, but {rate}{_advice(options)}")
    if rate and check.get("lit") is not None and check["lit"] < check["promised"] - COLOUR_SHORTFALL:
        said.append(f"small lit pictures have {check['lit']:.1f} dB, but {rate}; the shading differs from the source's")
    if rate and check.get("outline") is not None and check["outline"] < check["promised"] - OUTLINE_SHORTFALL:
        said.append(f"small pictures have {check['outline']:.1f} dB with their outlines, but {rate}; --keep-mesh keeps outlines")
    return said


def _advice(options):
    """Return advice for keeping more detail, "" if no option is left."""
    ways = ["a higher --rate"] if options.rate != max(RATES) else []
    ways += ["--support texels"] if options.support != "texels" else []
    return f"; {' or '.join(ways)} may keep more detail" if ways else ""


def _named(missed):
    """Return the name and quality of the worst part, and the number of others."""
    others = f" and {len(missed) - 1} more" if len(missed) > 1 else ""
    return f"part {missed[0]}{others}"


def _decoded(encoded, options, seconds):
    """Return (Texf of a stream, [units whose values were decoded from its bytes, all units])."""
    left, counts = [SHARE * seconds / SECONDS_PER_VALUE], [0, 0]

    def known(values, group):
        plane = group.join(encoded.values[values["field_index"]])
        counts[1] += 1
        if plane.size > left[0]:
            return plane
        left[0] -= plane.size
        counts[0] += 1
        return None

    texf = decode_stream(encoded.data, DecodeOptions(threads=options.threads, limits=UNLIMITED), Report(), known)
    return texf, counts


def _seen(scene, texf, options):
    """Return {"lit" or "flat": PSNR of Y of a few small pictures, None if they are equal; "outline": with their outlines}; {} if
    they cannot be compared: no pixel shows both sides, or light makes a colour infinite."""
    lit = options.effects in ("auto", "all") and not all(material.unlit for material in scene.materials)
    settings = ViewSettings(environment=DAYLIGHT) if lit else ViewSettings()
    try:
        seen = compare_views(scene, texf, VIEWS, SIZE, threads=options.threads, settings=settings)
    except InputError:
        return {}
    return {"lit" if lit else "flat": seen["psnr"]["y"], "outline": seen["union_psnr"]["y"]}
