"""The page of what holds under load, made of what the parts of tools/proof/load.py have measured."""

from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table, wrapped
from tools.proof.load_cluster import NAP_SECONDS
from tools.proof.load_faces import FEW, STEEPEST, slopes
from tools.proof.load_refused import TARGET as PEAK
from tools.proof.load_refused import WORST
from tools.proof.load_slope import TARGET as SLOPE
from tools.proof.load_slope import WARM

MB = 1 << 20


def page_of(found, faults, picture=None):
    """docs/reports/load.md. found: {part: what it measured}; faults: {part: sentences on what misses its target}; picture: path
    of load_faces.draw()'s plot from the page."""
    lines = ["# Under load", "", f"Made by `make -C tools load` (tools/proof/load.py) {made_on()}.", ""]
    for part, section in SECTIONS.items():
        if part in found:
            missed = faults[part]
            shown = [f"![processor seconds over faces, texels and voxels]({picture})", ""] if picture and part == "faces" else []
            lines += [*section(found[part]), "", *shown, *(["**Missed:**", "", *(f"- {text}" for text in missed)] if missed else
                                                   ["Nothing misses its target."]), ""]
    return "\n".join(wrapped(lines)).rstrip() + "\n"


def _slope(found):
    yield "## The same again and again"
    yield ""
    yield (f"Resident memory of one process after each call, by least squares after the first {WARM:.0%} of the calls, in which "
           f"caches fill; at most {SLOPE:,} bytes a call. Small scenes of seven kinds take turns: voxels, texels, alpha, maps, "
           "lossless, fast, 3DNTC. ± is the standard error of the slope. The allocator of the C library has one arena here: with "
           "its usual number, each of which keeps what threads have freed, encoding goes up in steps of 25 MB to some 350 MB and "
           "stays there.")
    yield ""
    rows = [[kind, row["calls"], f"{row['bytes a call']:,} ± {row['error']:,}", f"{row['first'] / MB:.1f}",
             f"{row['last'] / MB:.1f}"] for kind, row in found.items()]
    yield from markdown_table(["what", "calls", "bytes a call", "MB at first", "MB at last"], rows)


def _together(found):
    warm, cold, after = found["warm"], found["cold"], found["after"]
    yield f"## {found['processes']} processes at once"
    yield ""
    yield (f"Each codes and decodes the same scenes and vectors, beginning at another; all streams and arrays must be those of "
           f"one alone, which took {found['alone']['seconds']:.0f} s. With compiled kernels the {found['processes']} took "
           f"{warm['seconds']:.0f} s, with an empty cache, where each compiles what it finds missing, {cold['seconds']:.0f} s. "
           f"They left {cold['files']} files of kernels; one process that came after them took {after['seconds']:.0f} s and "
           f"wrote {after['compiled']} of these again.")


def _batch(found):
    yield "## A batch with faults"
    yield ""
    yield (f"`texf-enc --batch` over {found['assets']} good assets and {found['bad']} bad ones (not there, empty, noise, cut "
           "short, a header of 4,000,000,000 vertices, no glTF), two at a time, disturbed and called again with the same words, "
           f"{found['seconds']:.0f} s in all. In the end every good asset must have the stream that `texf-enc` alone makes of "
           "it, every bad one a coded error, and no other file may be there."
           + ("" if found["mounted"] else " The full disk was left out: this system mounts none for us."))
    yield ""
    rows = [[row["fault"], row["exit code"], row["streams"]] for row in found["tries"]]
    yield from markdown_table(["disturbed by", "exit code", "streams then"], rows)


def _refused(found):
    rows, tool = found["rows"], found["tool"]
    highest = max(row["peak"] for row in rows.values())
    base = "; ".join(f"{name} {size / MB:.0f} MB" for name, size in found["baselines"].items())
    yield "## Memory of refused files"
    yield ""
    yield (f"The highest resident memory of a process that refuses one of the {len(rows)} faulty conformance vectors; at most "
           f"{PEAK // MB} MB. Much of it is there before the first byte is read: {base}. Every vector was read in a fork of one "
           f"warm process that held {found['idle'] / MB:.0f} MB; the highest reached {highest / MB:.0f} MB. The table has "
           + (f"the {WORST} highest" if len(tool) > WORST else "the highest") + " of those that `texf-dec` refused in a process "
           f"of its own, which {len(tool)} did.")
    yield ""
    worst = sorted(tool, key=lambda name: -tool[name]["peak"])[:WORST]
    added = {name: (row["peak"] - row["began"]) / MB for name, row in rows.items()}
    table = [[name, tool[name]["code"], f"{tool[name]['peak'] / MB:.1f}", f"{added[name]:.1f}"] for name in worst]
    yield from markdown_table(["vector", "exit code", "MB, texf-dec", "MB that it added in a fork"], table)


def _levels(found):
    yield "## At the bounds of a level"
    yield ""
    yield ("Decoding, with kernels compiled and two threads, of streams that come near one bound of bitstream_spec.md 10.1 each: "
           "tori of vertex colours over voxels, a sheet with waves and noise over texels. Memory is what the process held at "
           "most beyond the idle decoder. Both are proportional to the counts (10.1). Latents were not measured.")
    yield ""
    rows = [[row["level"], row["kind"], f"{row['count']:,}", f"{row['bound']:,}", f"{row['bytes']:,}", f"{row['seconds']:.1f}",
             f"{row['memory'] / MB:,.0f}", f"{row['memory'] / row['count']:.0f}"] for row in found["rows"]]
    yield from markdown_table(["level", "near the bound of", "count", "bound", "bytes of the stream", "seconds", "MB",
                               "bytes of memory each"], rows)


def _faces(found):
    rows, powers = found["rows"], slopes(found)
    yield "## Many faces, texels and voxels"
    yield ""
    yield ("Encoding with the usual options and decoding to GLB, two threads, kernels compiled, of meshes made by "
           "tools/proof/face_meshes.py: scans, and inputs that are hard. Texels and voxels grow on one scan of "
           f"{FEW:,} faces whose mesh is kept. Seconds are of the processor; silent is the longest part of "
           "them without a word of progress. Memory is what the process held at most beyond what it held before, the image "
           "included. The exponent is of the power of the size that the seconds grow with, by least squares over the "
           f"logarithms; at most {STEEPEST}.")
    yield ""
    table = []
    for row in rows:
        cells = [(f"{row[what]['seconds']:.1f}", f"{row[what]['silence']:.1f}", f"{row[what]['memory'] / row['count']:,.0f}")
                 for what in ("encode", "save")]
        table.append([row["kind"], f"{row['count']:,} {row['of']}", *cells[0], *cells[1]])
    yield from markdown_table(["mesh", "size", "s, encode", "s silent", "bytes of memory each", "s, to GLB", "s silent",
                               "bytes of memory each"], table)
    yield ""
    yield from markdown_table(["mesh", "exponent, encode", "exponent, to GLB"],
                              [[kind, f"{own['encode']:.2f}", f"{own['save']:.2f}"] for kind, own in powers.items()])


def _cluster(found):
    encodes, naps, single = found["encodes"], found["naps"], found["alone"]
    count = encodes[0]["tasks"]
    yield "## Through a Dask cluster"
    yield ""
    yield (f"Scheduler and workers as processes on the loopback, workers of one thread, all on the processors named above. "
           f"{count} generated spheres of some hundred faces are coded by `texf-enc --effort fast --no-check` in a process each, "
           f"first without Dask, two at a time: {single['seconds']:.0f} s, {1000 * single['processor'] / count:,.0f} ms of the "
           "processor each. Every one must come back once, with the same stream. More "
           "workers than cores only show that nothing breaks. What Dask adds is seen "
           f"with {naps[0]['tasks']:,} tasks that sleep {1000 * NAP_SECONDS:.0f} ms in the encoder's place. The load average of "
           f"the machine was {found['load']:.1f} before: the lower, the more seconds by the wall clock say. Milliseconds a task "
           "are of the processor.")
    yield ""
    rows = [["encodes", row["workers"], row["tasks"], *_rates(row, 0.0)] for row in encodes]
    rows += [["naps", row["workers"], row["tasks"], *_rates(row, NAP_SECONDS)] for row in naps]
    yield from markdown_table(["tasks", "workers", "count", "s", "tasks a second", "share of what the workers could do",
                               "scheduler, ms a task", "client, ms a task", "workers, ms a task"], rows)
    yield ""
    yield from _million(naps[-1], found["sample"])


def _rates(row, nap):
    """Cells on a row; nap: seconds of each, 0 where the share has no meaning."""
    share = f"{row['tasks'] * nap / row['workers'] / row['seconds']:.0%}" if nap else ""
    used = [f"{1000 * row[key] / row['tasks']:.1f}" for key in ("scheduler", "client", "helpers")]
    return [f"{row['seconds']:.0f}", f"{row['tasks'] / row['seconds']:.1f}", share, *used]


def _million(row, sample):
    """What 10^6 assets would take, computed from a row of naps and an encode of the demo asset."""
    apart = max(row["scheduler"], row["client"]) / row["tasks"]
    hours, days = MILLION * sample["seconds"] / 3600, MILLION * apart / 86400
    yield (f"**What 10^6 assets would take**, computed and not measured: assets like the demo asset at its default rate take "
           f"{sample['seconds']:.0f} s of the processor each, {hours:,.0f} core hours in all, and "
           f"{MILLION * sample['bytes'] / 1e9:,.0f} GB of streams. Client and scheduler, which cannot be shared out, are two "
           f"processes; the busier one takes {1000 * apart:.1f} ms a task, {days:.1f} days for 10^6 tasks, so that one cluster "
           f"feeds {sample['seconds'] / apart:,.0f} cores at most with such encodes.")


MILLION = 10**6
SECTIONS = {"slope": _slope, "together": _together, "batch": _batch, "refused": _refused, "levels": _levels, "faces": _faces,
            "cluster": _cluster}
