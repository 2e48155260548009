"""docs/reports/results.md: the paper's rows beside ours, who wins where and why, and lossy geometry.

Folders or kept rows whose names begin with all_assets, paper, resident and lossy_geometry are the parts of the page; one that is
not given is left out, and the page says so.
"""

import math

import numpy as np

from tools.bench.differences import Pair, summary
from tools.bench.jobs import REPOSITORY, code_of
from tools.bench.provenance import state_of
from tools.bench.result_tables import markdown_table, missing_table
from tools.bench.results import AUTO, OURS, grouped, quality_of, rate_of, read_missing, read_results

ANCHOR, VERTEX_ANCHOR = "UV-Source HEVC", "vertex colours, Draco"
SHOWN = ("image PSNR Y", "3D-PSNR Y", "SSIM")
SHARED = ("Each row is over the qualities that it shares with the anchor, and two rows may share others: codecs on the same "
          "voxels are compared in [attribute coding](attribute_coding.md).")
RASTER = 256  # texels along the longer side of the raster that counts those which are shown
SCANS = ("bball_0001", "mars_terrain16", "mp_room_lod3", "ycb_chef_can", "ycb_scissors")
# (our group, what the paper calls the row, its BD-rate by image PSNR on its MPEG and AOM meshes), against UV-Source HEVC.
PAPER = (
    ("UV-Reparam HEVC", "UV-Reparam/HEVC", (-28, -45)), ("UV-Reparam AV1", "UV-Reparam/AV1", (-34, -48)),
    ("TexF/G-PCC raht", "TexF/G-PCC", (-33, -55)), ("TexF voxels, no refinement", "TexF/Unicorn without IR", (-52, -63)),
    ("TexF voxels, inverse rendering", "TexF/Unicorn", (-47, -63)), ("TexF voxels, baked", "TexF/Unicorn, UV-baked", (-46, -60)),
    ("Serialized-Morton HEVC", "Serialized-Morton", (112, 21)), ("Serialized-Hilbert HEVC", "Serialized-Hilbert", (78, 5)),
)
RESIDENT = (("3DNTC", "TexF/3DNTC", (-33, -31)), ("UV-Source NTC", "NTC", (-7, -4)))


def differences_of(rows, group, anchor, kind="texture"):
    """Return {asset: {measure: Difference}} of a group of rows against another; {} if one is missing. kind: "texture" or
    "total"."""
    groups = grouped(rows)
    if group not in groups or anchor not in groups:
        return {}
    return Pair(group, anchor, groups[group], groups[anchor]).differences(kind)


def percent(difference):
    """Return a Difference as the text of a table cell."""
    return "-" if difference is None or difference.percent is None else f"{difference.percent:+.1f}"


def mean_and_median(table, measure):
    """Return two cells, over the assets of a dict of differences_of()."""
    values = [row[measure] for row in table.values() if measure in row]
    both = (summary(values), summary(values, np.median))
    return [f"{value:+.1f} ({count})" if value is not None else "-" for value, count in both]


def paper_lines(rows, wanted, anchor):
    """Return the lines of a Markdown table: the paper's BD-rates (wanted) beside ours against the group `anchor`."""
    groups = list(dict.fromkeys([*(name for name, _, _ in wanted), *grouped(rows)]))
    by_group, lines = {name: (row, figures) for name, row, figures in wanted}, []
    for group in groups:
        table = differences_of(rows, group, anchor) if group != anchor else {}
        row, figures = by_group.get(group, ("-", None))
        if not table:
            if group in by_group:
                lines.append([group, row, f"{figures[0]:+d} / {figures[1]:+d}", *["not run"] * 5])
            continue
        cells = [percent(table.get("bball_0001", {}).get(measure)) for measure in SHOWN[:2]]
        lines.append([group, row, f"{figures[0]:+d} / {figures[1]:+d}" if figures else "-", *cells,
                      *mean_and_median(table, SHOWN[0]), mean_and_median(table, SHOWN[1])[1]])
    head = ["group", "in the paper", "there: MPEG / AOM, PSNR", "bball_0001, image Y", "3D Y", "mean, image Y", "median",
            "median, 3D Y"]
    return markdown_table(head, lines, 2)


def by_asset_lines(rows, anchor):
    """Return the lines of a Markdown table: every group against the group `anchor`, asset by asset, in image PSNR of Y."""
    tables = {group: differences_of(rows, group, anchor) for group in grouped(rows) if group != anchor}
    assets = sorted({row["asset"] for row in rows})
    lines = [[group, *(percent(table.get(asset, {}).get(SHOWN[0])) for asset in assets)] for group, table in tables.items()]
    return markdown_table(["group", *assets], sorted(lines), 1)


def asset_lines(rows, facts):
    """Return the lines of a Markdown table: what auto does on every asset against the source's UVs with HEVC, or against vertex
    colours if those were run. facts: {asset: asset_facts()}."""
    table = {**differences_of(rows, AUTO, ANCHOR, "total"), **differences_of(rows, AUTO, VERTEX_ANCHOR, "total")}
    rivals = grouped(rows).get(ANCHOR, {}) | grouped(rows).get(VERTEX_ANCHOR, {})
    lines = []
    for asset in sorted(table):
        row, asset_facts = table[asset], facts.get(asset, {})
        anchors = rivals.get(asset, [])
        first = row.get(SHOWN[0])
        shared = "-" if first is None or first.overlap is None else f"{first.overlap:.0%}"
        lines.append([asset, *(asset_facts.get(key, "-") for key in ("faces", "texels_per_face", "reuse")), uv_bytes(anchors),
                      over_what(rows, asset), *(percent(row.get(measure)) for measure in SHOWN), shared,
                      why(row, anchors, asset_facts)])
    head = ["asset", "faces", "texels a face", "texel shown", "UV bytes", "auto is over", *SHOWN, "shared range", "why"]
    scans = {asset: table[asset] for asset in table if asset in SCANS}
    for name, part in (("all", table), ("scans", scans)):
        for title, number in (("mean", 0), ("median", 1)):
            cells = [mean_and_median(part, measure)[number] for measure in SHOWN]
            lines.append([f"**{title}, {name}**", *[""] * 5, *cells, "", ""])
    head, rule, *lines = markdown_table(head, lines)
    return [head, rule.removesuffix("---: |") + "--- |", *lines]  # words in the last column


def uv_bytes(rows):
    """Bytes of UVs of the anchor, a cell."""
    most = max((row["bytes"].get("uv", 0) for row in rows), default=0)
    return f"{most:,}" if most else "no UVs"


def over_what(rows, asset):
    """What the encoder chose at r03, a cell."""
    for row in grouped(rows).get(AUTO, {}).get(asset, []):
        if row["setting"].endswith("r03"):
            chosen = row["facts"].get("supports", [])
            texels = chosen.count("texels")
            return "voxels" if not texels else "texels" if texels == len(chosen) else f"texels, {texels} of {len(chosen)}"
    return "-"


def why(row, anchors, asset_facts):
    """Who wins, and what its bytes say of the reason, a cell."""
    first = row.get(SHOWN[0])
    if first is None or first.percent is None:
        return first.reason if first else "not measured"
    parts = ["TexF" if first.percent < 0 else "the rival"]
    if uv_bytes(anchors) != "no UVs":
        middle = sorted(anchors, key=lambda r: rate_of(r, "texture"))[len(anchors) // 2]
        share = middle["bytes"].get("uv", 0) / max(rate_of(middle, "texture"), 1)
        parts.append(f"UVs are {share:.0%} of the rival's middle point")
    if "unused" in asset_facts:
        parts.append(f"{asset_facts['unused']:.0%} of its texels are never shown")
    return "; ".join(parts)


def asset_facts(path):
    """{"faces", "texels_per_face", "reuse", "unused"} of an asset: texels that the surface shows, how often, and how many of the
    images' it does not."""
    from texfcodec.io.load import load

    scene = load(str(path))
    texels, shown, whole = np.sum([(0, 0, 0), *_counts_of_images(scene)], axis=0)
    facts = {"faces": f"{len(scene.faces):,}"}
    if texels > 0:
        facts |= {"texels_per_face": f"{texels / len(scene.faces):,.1f}", "unused": max(1 - texels / whole, 0),
                  "reuse": f"{shown / texels:.2f} times"}
    return facts


def _counts_of_images(scene):
    """Yields (texels that the surface shows, the same with each as often as it is shown, all texels) of every image; the first is
    counted on a raster of at most RASTER texels a side."""
    from texfcodec.encoder.prepare.stage import prepare
    from texfcodec.encoder.requests import Requests
    from texfcodec.encoder.supports.image_groups import image_groups
    from texfcodec.encoder.supports.texel_plan import TexelPlan, covered_texels, most_fraction_bits
    from texfcodec.options import EncodeOptions
    from texfcodec.report import Report

    begun = prepare(scene, Requests.of(EncodeOptions(effects="none")).prepare, Report())
    for group in image_groups(begun.scene, begun.surface):
        size = tuple(max(1, round(side * min(1.0, RASTER / max(group.size)))) for side in group.size)
        plan, whole = TexelPlan(group, size, min(2, most_fraction_bits(size, group))), math.prod(group.size)
        uv = plan.corner_uv().reshape(-1, 2)
        count = len(covered_texels(plan, uv, np.arange(len(uv)).reshape(-1, 3), None, None))
        u, v = group.uv[:, 1] - group.uv[:, 0], group.uv[:, 2] - group.uv[:, 0]
        yield count * whole / math.prod(size), np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2, whole


def geometry_lines(rows):
    """Quality by bits of positions for both payloads, Markdown lines."""
    lines = []
    for asset in dict.fromkeys(row["asset"] for row in rows):
        for group in grouped(rows):
            points = grouped(rows)[group].get(asset, [])
            for row in sorted(points, key=lambda r: r["options"]["position_bits"]):
                sizes = [f"{row['bytes']['geometry']:,}", f"{rate_of(row, 'texture'):,}", f"{row['bytes']['total']:,}"]
                lines.append([asset, group, str(row["options"]["position_bits"]), *sizes,
                              *(f"{quality_of(row, measure):.2f}" for measure in SHOWN[:2])])
    return markdown_table(["asset", "payload", "bits", "geometry", "texture", "total", *SHOWN[:2]], lines, 2)


def page(args):
    """Lines of the whole page. args: of collect.py."""
    given = {kind: (read_results(folder), folder) for kind in ("all_assets", "paper", "resident", "lossy_geometry")
             for folder in args.results if folder.stem.startswith(kind)}
    if "all_assets" not in given or not args.assets:
        raise SystemExit("the page needs a folder or kept rows called all_assets, and --assets")
    rows, _ = given["all_assets"]
    paths = {name: args.assets / f"{name}.glb" for name in sorted({row["asset"] for row in rows} - {"sample"})}
    facts = {name: asset_facts(path) for name, path in paths.items() if path.exists()}
    out = ["# Results", "", "Made by `make -C tools results` from points of rate_points.py. BD-rate "
           "in percent at equal quality, negative: fewer bytes are needed; of the whole stream in the first part, because auto "
           "chooses the mesh as well, else of the texture, which is all but the bytes that positions and connectivity take "
           "alone, so that UVs count, ours over texels too. Base colour and alpha are coded, nothing else.", "",
           f"## Every asset: auto against {ANCHOR}", "",
           f"{_evaluation(rows)} Vertex colours have no UVs: there the rival is {VERTEX_ANCHOR}.", "",
           *asset_lines(rows, facts), ""]
    for title, kind, wanted, anchor in (("The paper's rows beside ours", "paper", PAPER, ANCHOR),
                                        ("On a GPU: the paper's rows beside ours", "resident", RESIDENT, "ASTC srgb")):
        out += [f"## {title}", ""]
        if kind not in given:
            out += ["Not measured for this page.", ""]
            continue
        rows, folder = given[kind]
        missing = read_missing(folder)
        out += [f"Against {anchor}. {_evaluation(rows)}", "", *paper_lines(rows, wanted, anchor), "",
                SHARED, "", f"{SHOWN[0]}, asset by asset:", "", *by_asset_lines(rows, anchor), ""]
        out += [*markdown_table(*missing_table(missing)), ""] if missing else []
    if "lossy_geometry" in given:
        rows, _ = given["lossy_geometry"]
        out += ["## Lossy geometry", "", _evaluation(rows), "", *geometry_lines(rows), ""]
    return out


def _evaluation(rows):
    """How many points, by which code ours are, and what was looked at: sentences."""
    image, ours = rows[0]["image"] or {}, [row for row in rows if row["method"] in OURS]
    codes = {method: code_of(method, ()) for method in {row["method"] for row in ours}}
    now = sum(row["code"] == codes[row["method"]] for row in ours)
    share = f"all {now} of ours" if now == len(ours) else f"**{now} of {len(ours)} of ours**"
    return (f"{len(rows)} points, {share} by the code of commit {state_of(REPOSITORY)}, rivals' by it or older code; "
            f"{image.get('views', 0)} views of {image.get('size', 0)} pixels a side.")
