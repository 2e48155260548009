"""Packages of others with codecs of their own, written where a test asks for them: modules, and a real entry_points.txt."""

from shapes import crossing_sheets

from texfcodec import EncodeOptions, encode

# Values as they are, or packed; no levels of its own.
TOY = '''
import zlib

import numpy as np

from texfcodec import InputError, PlaneCodec
from texfcodec.core.syntax_table import Element, Structure

PARAMETERS = Structure("toy_parameters", "toy", (Element("packed", "u8", 0, 1), Element("toy_data", "bytes")))


class Toy(PlaneCodec):
    id, name, purpose = 200, "toy", "to try things"
    structures = (PARAMETERS,)
    has_levels = False

    def check_options(self, options):
        if options.codec_options.keys() - {"pack"}:
            raise InputError("TXF-I50", "toy knows pack alone", value=", ".join(options.codec_options))

    def enc(self, plane, support, options):
        decoded = np.clip(np.rint(plane), 0, 255).astype(np.uint8)
        packed = bool(options.codec_options.get("pack"))
        data = decoded.tobytes()
        return {"packed": int(packed), "toy_data": zlib.compress(data) if packed else data}, decoded

    def dec(self, values, support, levels, threads):
        assert levels == 0
        data = bytes(values["toy_data"])
        data = zlib.decompress(data) if values["packed"] else data
        return np.frombuffer(data, np.uint8).reshape(len(support), values["NumComponents"])

    def describe(self, values):
        return {"packed": values["packed"], "data_bytes": len(values["toy_data"])}

    def info_lines(self, group):
        yield f"toy: {group['data_bytes']} bytes"
'''

# The mean of all voxels for any point: one unit for all fields.
JOINT = '''
import numpy as np

from texfcodec import JointCodec
from texfcodec.codecs.base import Joint
from texfcodec.core.syntax_table import Element, Structure


class Tint:
    def __init__(self, tint):
        self.tint = np.array(tint, np.uint8)

    def values(self, support, threads):
        return np.tile(self.tint, (len(support), 1))

    def query(self, cube, points, threads):
        out = np.tile(self.tint, (len(points), 1)).astype(np.float32)
        return out


class Tinted(JointCodec):
    id, name = 201, "tint"
    structures = (Structure("tint_parameters", "tint", (Element("tint", "u8", count="NumOutputs"),)),)
    TINT = (200, 100, 50, 25)

    def enc(self, source, options, report):
        tint = list(self.TINT[:sum(group.components for group in source.groups)])
        return Joint({"tint": tint}, [Tint(tint) for _ in source.surfaces], {"tint": tint})

    def dec(self, values, surfaces, position_bits, groups, options, report):
        return [Tint(values["tint"]) for _ in surfaces]

    def pack(self, evaluators):
        return {"count": len(evaluators)}, {"keys": np.array([one.tint for one in evaluators])}

    def unpack(self, facts, arrays, groups, fields):
        return [Tint(tint) for tint in arrays["keys"]]

    def result_lines(self, facts):
        yield f"tinted {facts['tint']}"
'''


def write_plugin(folder, points, **modules):
    """A package's modules and its list of entry points. points: {codec name: "module:Class"}; modules: text by name."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    info = folder / f"{folder.name}-1.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {folder.name}\nVersion: 1.0\n", encoding="utf-8")
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    (info / "entry_points.txt").write_text("[texfcodec.codecs]\n" + lines, encoding="utf-8")
    return folder


def toy_stream(**options):
    """Two crossing sheets coded with the plug-in toy, wherever it comes from."""
    return encode(crossing_sheets(), EncodeOptions(codec="toy", resolution=24, refine="off", **options))
