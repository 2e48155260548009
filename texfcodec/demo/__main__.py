"""The main job on the bundled sample: encode at three settings, decode to GLB, print a table. `make demo` runs this.

The settings: few voxels, as in the paper, and two rates with the encoder's own choice of texels and voxels.

    python -m texfcodec.demo [FOLDER]
"""

import sys
import time
from os import PathLike
from pathlib import Path

POINTS = {"voxels": {"resolution": 256, "qp": 28}, "r02": {"rate": "r02"}, "r04": {"rate": "r04"}}
STAGES = ("load", "supports", "partition", "geometry", "voxelise", "texels", "transfer", "refine", "attributes")


def main(folder: str | PathLike = "out") -> None:
    """Write the sample mesh, and three streams of it and their decoded GLBs, into a folder; print sizes, quality and seconds of
    each."""
    from rich.console import Console

    from ..batch.compile_beside import compile_beside
    from ..options import default_threads
    from ..precompile import ALL, first_run
    from .asset import write_or_explain

    begin, console, folder = time.perf_counter(), Console(), Path(folder)
    folder.mkdir(exist_ok=True)
    source = folder / "sample.glb"
    write_or_explain(source)
    console.print(f"{source}: {source.stat().st_size:,} bytes, generated")
    line = first_run(ALL)
    if line:
        console.print(line)
        compile_beside(default_threads(), "encode", "save")
    rows = []
    for name, point in POINTS.items():
        with console.status(f"{name}: encoding and decoding"):
            rows.append(_one_rate(source, folder / f"sample_{name}.texf", point))
    console.print(_table(rows))
    console.print(f"{time.perf_counter() - begin:.0f} s in total. Open in any glTF viewer: {source}, "
                  + ", ".join(str(folder / f"sample_{name}.glb") for name in POINTS), soft_wrap=True)
    console.print(f"To list the elements of a stream: texf-info {folder / f'sample_{list(POINTS)[0]}.texf'}", soft_wrap=True)


def _one_rate(source, stream, point):
    """Encodes, measures, decodes and saves beside the stream; returns the result and the seconds."""
    from .. import EncodeOptions, Report, decode, encode_to_result

    options, coding, decoding = EncodeOptions(**point, measure=True), Report(), Report()
    encoded = encode_to_result(source, options, coding)
    stream.write_bytes(encoded.data)
    texf = decode(encoded.data, report=decoding)
    with decoding.stage("save"):
        texf.save(stream.with_suffix(".glb"))
    return {"encoded": encoded, "coding": coding.seconds, "decoding": decoding.seconds}


def _table(rows):
    from rich.table import Table

    from ..core.colour_error import EXACT

    table = Table(title="texfcodec on the bundled sample", title_justify="left")
    table.add_column("", no_wrap=True)
    for row in rows:
        table.add_column(_head(row["encoded"]), justify="right")
    sizes = [row["encoded"].sizes for row in rows]
    for kind in ("total", "geometry", "attributes", "other"):
        table.add_row(f"bytes, {kind}", *(f"{s[kind]:,}" for s in sizes))
    counts = [row["encoded"].counts for row in rows]
    for kind in ("voxels", "texels", "fields"):
        table.add_row(kind, *(f"{c[kind]:,}" for c in counts))
    bits = [8 * s["attributes"] / (c["voxels"] + c["texels"]) for s, c in zip(sizes, counts, strict=True)]
    table.add_row("attribute bits per voxel or texel", *(f"{b:.3f}" for b in bits))
    for name, key in (("Y", "y"), ("YUV 6:1:1", "yuv611"), ("RGB", "rgb")):
        psnr = [row["encoded"].psnr_3d[key] for row in rows]
        table.add_row(f"3D-PSNR {name}, dB", *(EXACT if v is None else f"{v:.2f}" for v in psnr))
    table.add_section()
    for stage in STAGES:
        table.add_row(f"encode: {stage}, s", *(f"{row['coding'].get(stage, 0):.2f}" for row in rows))
    for stage in ("geometry", "voxelise", "texels", "attributes", "save"):
        name = "save as GLB" if stage == "save" else stage
        table.add_row(f"decode: {name}, s", *(f"{row['decoding'].get(stage, 0):.2f}" for row in rows))
    return table


def _head(encoded):
    """Heading of a column: QP, and K if anything is over voxels."""
    grid = [f"K {encoded.resolution}"] * (encoded.counts["voxels"] > 0) + ["texels"] * (encoded.counts["texels"] > 0)
    return f"{' + '.join(grid)}\nQP {encoded.qp}"


if __name__ == "__main__":
    main(*sys.argv[1:2])
