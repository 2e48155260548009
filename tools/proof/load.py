"""What holds under load: memory over hundreds of calls, processes at once, a batch with faults, memory of refused files, what
streams at the bounds of a level take, and how time and memory grow with the faces of a mesh.

python tools/proof/load.py [--part slope|together|batch|refused|levels|faces|cluster ...] [--out FOLDER]
        [--page docs/reports/load.md]
                     [--calls N] [--every]

Each part leaves a file in the folder; the page is made of all that lie there, so that parts may be measured one by one. --every
puts every faulty vector through texf-dec, and not the worst ten alone. Exit code 7: a part of the folder misses its target.
"""

import argparse
import json
import sys
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.core.json_text import json_text
from texfcodec.errors import EXIT_DIFFERS
from tools.proof.load_batch import GOOD, batch_faults, run_batch
from tools.proof.load_cluster import ENCODED, cluster_faults, run_cluster
from tools.proof.load_faces import SIZES, draw, faces_faults, run_faces
from tools.proof.load_levels import levels_faults, run_levels
from tools.proof.load_page import page_of
from tools.proof.load_refused import refused_faults, run_refused
from tools.proof.load_slope import CALLS, run_slopes, slope_faults
from tools.proof.load_together import PROCESSES, run_together, together_faults

PARTS = {"slope": slope_faults, "together": together_faults, "batch": batch_faults, "refused": refused_faults,
         "levels": levels_faults, "faces": faces_faults, "cluster": cluster_faults}


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=list(PARTS), help="repeatable; without it all of them")
    parser.add_argument("--page-only", action="store_true", help="measure nothing")
    parser.add_argument("--out", type=Path, default=Path("out/load"))
    parser.add_argument("--calls", type=int, default=CALLS, metavar="N", help="of each kind")
    parser.add_argument("--processes", type=int, default=PROCESSES, metavar="N", help="at once")
    parser.add_argument("--assets", type=int, default=GOOD, metavar="N", help="good ones of the batch")
    parser.add_argument("--faces", type=int, nargs="+", default=SIZES, metavar="N", help="of the meshes that grow")
    parser.add_argument("--large", action="store_true", help="let them grow up to three million faces: another half hour")
    parser.add_argument("--encodes", type=int, default=ENCODED, metavar="N", help="for each size of the cluster")
    parser.add_argument("--every", action="store_true")
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    measures = {"slope": lambda: run_slopes(args.calls), "together": lambda: run_together(args.processes),
                "batch": lambda: run_batch(args.assets), "refused": lambda: run_refused(args.every),
                "levels": run_levels, "faces": lambda: run_faces(args.faces, large=args.large),
                "cluster": lambda: run_cluster(args.encodes)}
    for part in [] if args.page_only else args.part or PARTS:
        (args.out / f"{part}.json").write_text(json_text(measures[part](), indent=1), encoding="utf-8")
    found = {part: json.loads((args.out / f"{part}.json").read_text(encoding="utf-8")) for part in PARTS
             if (args.out / f"{part}.json").exists()}
    faults = {part: PARTS[part](told) for part, told in found.items()}
    plot = args.page.parent / "pictures" / "load.png" if args.page and "faces" in found else None
    text = page_of(found, faults, "pictures/load.png" if plot and draw(found["faces"], plot) else None)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)
    return EXIT_DIFFERS if any(faults.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
