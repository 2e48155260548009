"""Three streams as the encoder writes them every day, of the bundled sample at rate r03: over voxels, over texels, and with a map
in every slot of its materials. They are too large to be kept; conformance/whole.json has their SHA-256 and those of their arrays.

    python -m conformance.make.whole FOLDER            # makes them as cases in FOLDER, and says which are not as promised
    python -m conformance.make.whole FOLDER --write    # renews the list

    python conformance/run.py --home FOLDER [--decoder "<command>"]

They take five minutes to make. The naive decoder would take hours over them: what is in the list is what ours decodes.
"""

import argparse
import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path

from decode_texfcodec import arrays

from texfcodec import EncodeOptions, encode
from texfcodec.demo.asset import make_sample

LIST = Path(__file__).resolve().parents[1] / "whole.json"
LODS = (0, 2)
MAPS = ("roughness", "metallic", "occlusion", "emissive", "normal")


def sample_with_maps():
    """The sample, whose photographs are maps of its materials as well."""
    scene = make_sample()
    pictures = len(scene.textures)
    maps = lambda n: {name: i % pictures for i, name in enumerate(MAPS, n)}
    scene.materials = [replace(m, maps=maps(n), parameters={"emissive": (1.0, 1.0, 1.0)})
                       if m.texture >= 0 else m for n, m in enumerate(scene.materials)]
    return scene


MADE = {
    "whole/voxels": lambda: encode(make_sample(), EncodeOptions(rate="r03", support="voxels")),
    "whole/texels": lambda: encode(make_sample(), EncodeOptions(rate="r03", support="texels")),
    "whole/maps": lambda: encode(sample_with_maps(), EncodeOptions(rate="r03", effects="all")),
}


def case_of(data):
    """Content of case.json."""
    digest = lambda content: hashlib.sha256(content).hexdigest()
    lods = {str(lod): {name: digest(content) for name, content in arrays(data, lod).items()} for lod in LODS}
    return {"bytes": len(data), "sha256": digest(data), "lods": lods}


def main(arguments=None):
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args(arguments)
    listed, cases = json.loads(LIST.read_text(encoding="utf-8")) if LIST.is_file() else {}, {}
    for name, make in MADE.items():
        data = make()
        case = cases[name] = case_of(data)
        place = args.folder / name
        place.mkdir(parents=True, exist_ok=True)
        (place / "in.texf").write_bytes(data)
        (place / "case.json").write_text(json.dumps(listed.get(name, case), indent=1) + "\n", encoding="utf-8")
        print(f"{name}: {case['bytes']} bytes, {'as listed' if listed.get(name) == case else 'not as listed'}", flush=True)
    if args.write:
        LIST.write_text(json.dumps(cases, indent=1) + "\n", encoding="utf-8")
    return 0 if args.write or cases == listed else 7


if __name__ == "__main__":
    sys.exit(main())
