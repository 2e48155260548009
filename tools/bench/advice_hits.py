"""How often `texf-enc --advise` foretells what the encoder then chooses."""

from texfcodec.encoder.advise import advise
from texfcodec.encoder.plan import outline
from texfcodec.io.load import load
from texfcodec.options import EncodeOptions
from texfcodec.report import Report
from tools.bench.result_tables import markdown_table

# The constants of encoder/advise.py were made on these.
TUNED = ("avocado", "cat_webp", "clearcoat_blend", "hard_broken", "house_mask", "mp_room_lod3", "tiny_plane", "virtual_city",
         "ycb_chef_can")


def hits_of(row, scene):
    """[(whether the advice came true, whether it was sure)] by image of a row of our own method."""
    told = advise(outline(scene, EncodeOptions(**row["options"]), Report()))["images"]
    chosen = row["facts"].get("supports", [])
    if len(told) != len(chosen):
        return []
    return [(entry["predicted"] == support, entry["sure"]) for entry, support in zip(told, chosen, strict=True)]


def hit_lines(rows, paths, group="TexF auto"):
    """Markdown lines: hits by asset over the rates of a group of rows; paths: {asset: path}."""
    lines, totals = [], {True: [], False: []}
    for asset in sorted(paths):
        scene, hits, rates = load(str(paths[asset])), [], []
        for row in rows:
            if row["asset"] == asset and row["group"] == group:
                hits += hits_of(row, scene)
                rates.append(row["setting"])
        if not hits:
            continue
        tuned = asset in TUNED
        totals[tuned] += [hits]
        sure = [hit for hit, is_sure in hits if is_sure]
        lines.append([asset, "tuned on" if tuned else "held out", str(len(hits)), _share([hit for hit, _ in hits]),
                      _share(sure) + f" of {len(sure)}"])
    for tuned, title in ((True, "tuned on"), (False, "held out")):
        every = [hit for hits in totals[tuned] for hit, _ in hits]
        means = [sum(hit for hit, _ in hits) / len(hits) for hits in totals[tuned]]
        sure = [hit for hits in totals[tuned] for hit, is_sure in hits if is_sure]
        mean = f", {sum(means) / len(means):.0%} in the mean over assets" if means else ""
        lines.append([f"**{title}**", "", str(len(every)), _share(every) + mean, _share(sure) + f" of {len(sure)}"])
    return markdown_table(["asset", "", "choices", "foretold", "where it was sure"], lines, 2)


def _share(hits):
    return f"{sum(hits) / len(hits):.0%}" if hits else "-"
