"""Whole materials against what a user would pick instead: Draco with all its attributes, and every map as AVIF.

    python -m tools.bench.materials rivals ASSET.glb ... --out FOLDER     the curves of the rival, slow, once
    python -m tools.bench.materials ours ASSET.glb ... --out FOLDER       our streams at some QPs
    python -m tools.bench.materials compare FOLDER                        one table, Markdown
    python -m tools.bench.materials effects ASSET.glb ...  what is coded of every asset, and what it costs, Markdown
    python -m tools.bench.materials seconds ASSET.glb ...                 seconds of both sides, coding and decoding, Markdown

--keep-old leaves assets alone that have a record in the folder, so that the same command goes on where it was stopped.

Both sides are looked at twice: map by map, PSNR of a map's used columns over the texels that the surface asks, bytes of that map
alone; and all together, PSNR of Y of shaded pictures, bytes of everything, and of everything but what Draco takes for positions
and faces alone. Images that a file uses for several maps are coded once. material_rivals.py describes the rival; its AVIF is
Pillow's at the better of 4:2:0 and 4:4:4, at every size of SCALES.
"""

import argparse
import io
import json
import time
from copy import copy
from pathlib import Path

import DracoPy
import numpy as np

from texfcodec.api import decode, encode_to_result
from texfcodec.bitstream.inspect import inspect
from texfcodec.core.colour_error import decibels, in_decibels
from texfcodec.core.json_text import json_text
from texfcodec.decoder import decode_stream
from texfcodec.encoder.prepare.materials import needed_scene
from texfcodec.encoder.values.shown_maps import turn_of, turned
from texfcodec.field.morton import decode_morton
from texfcodec.field.texel_set import asked_texels
from texfcodec.geometry.surface import make_surface
from texfcodec.io.atlas.sheets import sheet_colours
from texfcodec.io.load import load
from texfcodec.metrics.bd_rate import bd_rate
from texfcodec.metrics.effect_times import effect_times
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.report import Report
from texfcodec.scene.channels import BASE_COLOUR, channel_over
from texfcodec.scene.effects import EFFECT_OF
from texfcodec.scene.fetch import values_of_map
from tools.bench.everyday_rivals import CornerFrames, dec_image, draco_bytes, enc_mesh, octahedral, quantise_uv, rival_of, shrunk
from tools.bench.material_rivals import SPEED, rival_record
from tools.bench.material_views import LitViews
from tools.bench.result_tables import markdown_table

QPS = (20, 24, 28, 32, 36, 40)
VIEWS, SIZE = 8, 768
MOST, MEAN = 75, 45  # the target, of total bytes: percent of the rival's on every asset, and on average


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("rivals", "ours", "compare", "effects", "seconds"))
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("tools/bench/materials"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--qp", type=int, action="append", help=f"of ours; repeatable; {QPS} if none is given")
    parser.add_argument("--keep-old", action="store_true", help="leave assets alone that have a record")
    parser.add_argument("--maps-only", action="store_true", help="no shaded pictures")
    given = parser.parse_args()
    if given.what == "compare":
        print("\n".join(compared(given.paths[0])))
        return
    if given.what == "effects":
        print("| asset | channel | decision | bytes | error | encode, decode ms | picture of 512^2 with / without, ms |")
        print("|---|---|---|---|---|---|---|")
        for path in given.paths:
            print("\n".join(effect_rows(path, given.threads)), flush=True)
        return
    if given.what == "seconds":
        print("\n".join(seconds_table(given.paths, given.threads)))
        return
    given.out.mkdir(parents=True, exist_ok=True)
    for path in given.paths:
        out = given.out / f"{path.stem}.{given.what}.json"
        if given.keep_old and out.exists():
            continue
        looked = _Looked(path, given.threads, not given.maps_only)
        record = rival_record(looked) if given.what == "rivals" else our_record(looked, given.qp or QPS)
        out.write_text(json_text(record, indent=1) + "\n", encoding="utf-8")


def seconds_table(paths, threads):
    """Lines of Markdown: processor seconds of both sides, with compiled kernels. Ours: r03, to arrays. Theirs: all maps at their
    own size as AVIF of quality 50 and 4:2:0, once, and Draco with UVs of 12 bits and normals of 8; by Pillow and DracoPy."""
    seconds_of(paths[0], threads)  # loads kernels; on an empty cache call it twice
    rows = [[path.stem, *(f"{seconds:.2g}" for seconds in seconds_of(path, threads))] for path in paths]
    return markdown_table(["asset", "encode, s", "theirs", "decode, s", "theirs"], rows)


def seconds_of(path, threads):
    """[Ours to encode, theirs, ours to decode, theirs]."""
    def timed(call):
        begin = time.process_time()
        made = call()
        return made, time.process_time() - begin

    scene, looked = load(str(path)), _Looked(path, threads, False)
    made, ours = timed(lambda: encode_to_result(scene, EncodeOptions(rate="r03", threads=threads)))
    _, back = timed(lambda: decode_stream(made.data, DecodeOptions(threads=threads), Report()))
    rival, images = rival_of(scene), [scene.textures[t].image for t in sorted({t for _, _, t in looked.maps()})]
    files, theirs = timed(lambda: [_avif(image, threads) for image in images])
    normal = rival.scene.corner_normal
    frames = None if normal is None else CornerFrames(octahedral(normal, 8), 8)
    uv = quantise_uv(rival, 12) if rival.textured.any() else None
    mesh, more = timed(lambda: enc_mesh(rival.lattice, rival.scene.faces, uv, 12, None, frames))
    _, again = timed(lambda: (DracoPy.decode(mesh), [dec_image(file) for file in files]))
    return ours, theirs + more, back, again


def _avif(image, threads):
    out = io.BytesIO()
    shrunk(image, 1, False).save(out, "AVIF", quality=50, speed=SPEED, subsampling="4:2:0", max_threads=threads)
    return out.getvalue()


class _Looked:
    """An asset, what of it is coded, and how it is looked at."""

    def __init__(self, path, threads, shaded):
        self.name, self.threads, self.scene = path.stem, threads, load(str(path))
        self.surface = make_surface(self.scene, EncodeOptions())
        self.needed = needed_scene(self.scene, self.surface, "auto").value.scene
        self._views = LitViews(self.scene, VIEWS, SIZE, threads) if shaded else None
        self._texels = {}

    def of(self, scene):
        """The same look at another Scene that shows the same with the same maps on the same UVs."""
        other = copy(self)
        other.scene = scene
        return other

    def psnr(self, other):
        """{"psnr", "psnr_y"} of shaded pictures of a Scene or Texf, RGB and Y in dB, None where they are exact or not wanted."""
        return {"psnr": None, "psnr_y": None} if self._views is None else self._views.psnr(other)

    def maps(self):
        """(material number, channel name, Texture) of all that is coded, base colour first."""
        for number in np.unique(self.surface.material).tolist():
            material = self.needed.materials[number]
            if material.texture >= 0:
                yield number, BASE_COLOUR.name, material.texture
            for name, texture in material.maps.items():
                yield number, name, texture

    def turn_back(self, number):
        """From the frame that a decoder makes of the UVs to that of a material's own tangents; None where they agree."""
        turn = turn_of(self.scene, self.surface, np.flatnonzero(self.surface.material == number))
        return None if turn is None else turn.T

    def texels(self, number, texture):
        """Columns and rows of the texels that a material's faces ask of an image, int64 [N, 2]."""
        image = self.scene.textures[texture].image
        key = number, image.shape[:2]
        if key not in self._texels:
            mine = self.surface.origin_face[self.surface.material == number]
            size = (image.shape[1], image.shape[0])
            steps = np.floor(self.scene.corner_uv[mine] * size * 4 + 0.5).astype(np.int64).reshape(-1, 2)
            keys = asked_texels(steps, np.arange(len(steps)).reshape(-1, 3), 2, size, tuple(self.scene.textures[texture].wrap))
            self._texels[key] = decode_morton(keys)[:, :2]
        return self._texels[key]

    def map_psnr(self, images):
        """{channel name: PSNR in dB} of decoded images uint8 [H, W, 4] by (material, channel)."""
        errors = {}
        for number, name, texture in self.maps():
            xy = self.texels(number, texture)
            both = self.scene.textures[texture].image, images[number, name]
            a, b = (_values(name, image[xy[:, 1], xy[:, 0]]) for image in both)
            errors.setdefault(name, []).append((float(((a - b) ** 2).mean()), len(xy)))
        return {name: decibels(max(np.average([e for e, _ in found], weights=[n for _, n in found]), 1e-4))
                for name, found in errors.items()}


def _values(name, texels):
    if name == BASE_COLOUR.name:
        return texels[:, :3].astype(np.float32)
    return values_of_map(name, texels)


def our_record(looked, qps):
    """Our streams: {"asset", "positions": bytes, "points", "maps"}."""
    points, maps, positions = [], {}, draco_bytes(rival_of(looked.scene), None, None)
    for qp in qps:
        made = encode_to_result(looked.scene, EncodeOptions(rate="r03", qp=qp, threads=looked.threads))
        texf, told = decode(made.data), inspect(made.data)
        groups = {}
        for group in told["groups"]:
            groups[group["semantic"]] = groups.get(group["semantic"], 0) + group["bytes"]
        psnr = looked.map_psnr(_our_images(looked, texf)) if all(f.over_texels for f in texf.fields) else {}
        for semantic, size in groups.items():
            names = [name.removesuffix("_object") for name in semantic.split(" + ")]
            maps.setdefault(semantic, []).append({"qp": qp, "bytes": size, **{n: psnr[n] for n in names if n in psnr}})
        point = {"qp": qp, "total": len(made.data), "map_bytes": made.sizes["attributes"], "groups": groups} | looked.psnr(texf)
        points.append(point)
        print(looked.name, point, flush=True)
    return {"asset": looked.name, "positions": positions, "points": points, "maps": maps}


def _our_images(looked, texf):
    """Decoded images uint8 [H, W, 4], at the size of the source's, by (material, channel)."""
    out = {}
    for number, name, texture in looked.maps():
        source, xy = looked.scene.textures[texture].image, looked.texels(number, texture)
        image, channel = source.copy(), channel_over(name, True)  # decoded UVs ask a few texels less along borders
        for n, part in enumerate(texf.fields):
            faces = (texf.face_field == n) & (texf.face_material == number)
            if not faces.any():
                continue
            scale = np.array([part.support.width, part.support.height]) / (source.shape[1], source.shape[0])
            place = np.minimum(((xy + 0.5) * scale).astype(np.int64) >> part.level_shift, np.array(part.support.size) - 1)
            there = part.support.rank[place[:, 1], place[:, 0]] >= 0
            mine = xy[there]
            values = part.support_of(channel.name).query((mine + 0.5) * scale, part.planes[channel.name], looked.threads)
            if channel.unit == "degrees":
                values = turned(values, looked.turn_back(number))
            if name == BASE_COLOUR.name:
                image[mine[:, 1], mine[:, 0], :3] = np.rint(values)
            else:
                image[mine[:, 1], mine[:, 0]] = sheet_colours({name: values})
        out[number, name] = image
    return out


def effect_rows(path, threads):
    """Lines of Markdown: the channels of an asset at r03."""
    made = encode_to_result(load(str(path)), EncodeOptions(rate="r03", threads=threads))
    report = Report()
    texf = decode_stream(made.data, DecodeOptions(threads=threads), report)
    times = effect_times(texf, threads=threads)
    units = [one | {"bytes": group["bytes"], "decode_ms": told["decode_ms"]} for one, group, told in
             zip(made.choices["channels"], inspect(made.data)["groups"], report.channels, strict=True)]
    told = {entry["channel"]: entry for entry in made.choices["effects"]}
    for name in ("base_colour", *told):
        mine = [unit for unit in units if {name, f"{name}_object"} & set(unit["channels"])]
        entry = told.get(name, {"coded": len(texf.materials), "constant": 0, "absent": 0})
        decision = ", ".join(f"{entry[word]} {word}" for word in ("coded", "constant", "absent") if entry[word])
        psnr = [unit["psnr"].get(name, unit["psnr"].get(f"{name}_object")) for unit in mine]
        worst = min((value for value in psnr if value is not None), default=None)
        others = [n for n in mine[0]["channels"] if n != name] if mine else []
        shared = f" (with {', '.join(others)})" if others and len(mine[0]["channels"]) > 1 else ""
        without = times["without_ms"].get(EFFECT_OF[name].name) if name in EFFECT_OF else times["unlit_ms"]
        cost = f"{sum(u['encode_ms'] for u in mine):.0f}, {sum(u['decode_ms'] for u in mine):.0f}" if mine else ""
        yield (f"| {path.stem} | {name} | {decision} | {sum(u['bytes'] for u in mine) or ''}{shared} | "
               f"{in_decibels(worst) if mine else ''} | {cost} | "
               + (f"{times['picture_ms']:.0f} / {without:.0f} |" if without is not None and mine else "|"))


def compared(folder):
    """Lines of Markdown: every asset, all together and map by map, and the target."""
    yield "| asset | what | ours of Draco + AVIF, bytes at equal PSNR |"
    yield "|---|---|---|"
    totals = []
    for path in sorted(folder.glob("*.ours.json")):
        ours, rival = json.loads(path.read_text()), json.loads((folder / path.name.replace(".ours.", ".rivals.")).read_text())
        for title, less in (("all bytes", ()), ("without positions", ("positions",))):
            found = _lit_percent(ours, rival, less)
            totals += [] if less or isinstance(found, str) else [found]
            yield f"| {ours['asset']} | **lit, {title}** | {_said(found)} |"
        for semantic, points in ours["maps"].items():
            names = [n for n in semantic.split(" + ") if n in points[0]]
            for other, theirs in rival["maps"].items():
                shared = [n for n in names if n in other.split(" + ")]
                if shared:
                    yield f"| {ours['asset']} | {semantic} ({other}) | {_said(_percent(points, theirs, shared))} |"
    if totals:
        yield f"| **all {len(totals)}** | **lit, all bytes** | mean {np.mean(totals):.0f} %, at most {max(totals):.0f} % |"
        yield f"| **target** | **lit, all bytes** | mean {MEAN} %, at most {MOST} % |"


def _lit_percent(ours, rival, less):
    """_percent() of whole assets at PSNR of Y of shaded pictures. less: keys of records, bytes that do not count."""
    if "positions" not in ours.keys() & rival.keys():
        return "a record is older than this comparison"
    curves = ([{"bytes": p["total"] - sum(one[key] for key in less), "y": p["psnr_y"]} for p in one["points"]]
              for one in (ours, rival))
    return _percent(*curves, ["y"])


def _said(percent):
    return percent if isinstance(percent, str) else f"{percent:.0f} %"


def _percent(points, theirs, names):
    """Our bytes in percent of the rival's at equal mean PSNR, over the range that both have; why not, where there is none. Exact
    pictures have no PSNR and are left out."""
    a, b = (_envelope([(p["bytes"], float(np.mean([p[n] for n in names]))) for p in one if None not in [p.get(n) for n in names]])
            for one in (theirs, points))
    try:
        return 100 + bd_rate(*zip(*a, strict=True), *zip(*b, strict=True))
    except (TypeError, ValueError) as error:
        return f"no common range: {error}"[:90]


def _envelope(points):
    """(bytes, PSNR) of the lower hull of points, bytes over PSNR: a curve through all that no other beats would climb every time
    that bits which do not pay there gain a hundredth of a dB. A hull of the bytes' logarithm would promise what nobody has coded:
    over PSNR that bends the other way."""
    def slope(a, b):
        return (b[0] - a[0]) / (b[1] - a[1])

    kept = []
    for point in sorted(points):
        if kept and point[1] <= kept[-1][1] + 1e-6:
            continue
        if kept and point[0] == kept[-1][0]:
            kept.pop()
        while len(kept) > 1 and slope(kept[-2], kept[-1]) >= slope(kept[-2], point):
            kept.pop()
        kept.append(point)
    return kept


if __name__ == "__main__":
    main()
