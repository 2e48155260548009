"""Milliseconds of frames by the fragment shaders that js/src ships, through EGL and OpenGL 3.3: beside those by compute.

    python -m tools.gpu.frames_egl INPUTS [SIDE] [REPEATS]

prints one JSON object a row. A process of its own, as a driver without EGL may hang.
"""

from __future__ import annotations

import base64
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .frames_asset import FEATURES, HIDDEN, INPUTS, OUTPUTS, WORDS, FrameAsset, asset_of, load_arrays
from .frames_cpu import picture_psnr

HERE = Path(__file__).parent
ASSETS = ("player_voxels", "player_3dntc", "helmet_voxels", "helmet_3dntc", "room_voxels")
WIDTH = 2048  # of a table's texture, as place() of js/src has it
VERTEX = """#version 330 core
in vec3 position;
out vec3 grid;
uniform mat3 u_axes;
uniform float u_zoom, u_scale;
uniform vec3 u_offset;
void main() {
  vec3 seen = u_axes * position;
  gl_Position = vec4(seen.xy / u_zoom, 0.5 * seen.z, 1.0);
  grid = position * u_scale + u_offset;
}
"""


def shaders_of(payload: dict[str, Any] | None, halves: np.ndarray | None) -> dict[str, str]:
    """{"voxels", "network": GLSL, "block": base64 of the uniform block} of js/src, by node; network and block None without a
    payload. Raises OSError and subprocess.CalledProcessError without node."""
    given = json.dumps({"payload": payload, "halves": [] if halves is None else halves.tolist()})
    done = subprocess.run(["node", str(HERE / "frames_glsl.mjs")], input=given, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def write_shaders(folder: Path) -> Path:
    """Writes the shaders of every asset beside its arrays, and returns the file. Raises as shaders_of()."""
    out, path = {}, folder / "frames_glsl.json"
    for name in ASSETS:
        if (folder / f"frames_{name}.npz.xz").exists():
            data = load_arrays(folder / f"frames_{name}.npz.xz")
            shaders = shaders_of(payload_of(data), data["halves"]) if "halves" in data else shaders_of(None, None)
            out[name] = {"shader": shaders["network"] or shaders["voxels"], "block": shaders["block"]}
    path.write_text(json.dumps(out))
    return path


def payload_of(data: dict[str, Any]) -> dict[str, Any]:
    """What networkGlsl() of js/src takes of stored arrays."""
    levels = [{"resolution": int(resolution), "log2": int(log2)} for resolution, log2, _ in data["levels"]]
    return {"features": FEATURES, "octaves": 3, "first_wave": int(data["first_wave"]), "widths": [INPUTS, *HIDDEN, OUTPUTS],
            "levels": levels}


class FragmentFrames:
    """Draws a FrameAsset, one field after the other. context: moderngl.Context; shader: GLSL of js/src."""

    def __init__(self, context: Any, asset: FrameAsset, shader: str, block: bytes | None, side: int) -> None:
        self.context, self.asset = context, asset
        self.program = context.program(vertex_shader=VERTEX, fragment_shader=shader)
        colour, depth = context.texture((side, side), 4), context.depth_renderbuffer((side, side))
        self.target = context.framebuffer([colour], depth)
        arrays, numbers = asset.arrays, asset.numbers
        self.shared = {"u_codes": self._table(arrays["latents"].reshape(-1, 1))} if "latents" in arrays else {
            "u_values_0_0": self._table(arrays["values"].view(np.uint8).reshape(-1, 4))}
        positions = context.buffer(arrays["positions"].tobytes())
        self.fields = []
        for number, field in enumerate(arrays["fields"]):
            faces = arrays["faces"][arrays["face_field"] == number]
            if len(faces):
                index = context.buffer(np.ascontiguousarray(faces, np.uint32).tobytes())
                vertices = context.vertex_array(self.program, [(positions, "3f", "position")], index)
                self.fields.append((vertices, *self._of_field(field)))
        self._set({"u_size": int(numbers["size"]), "u_last": int(numbers["last"]), "u_base_0": 0, "u_first_0": 0,
                   "u_first_1": int(numbers.get("first1", 0)), "u_scale": numbers["scale"],
                   "u_offset": tuple(numbers[f"offset_{axis}"] for axis in "xyz")})
        if block is not None:
            context.buffer(block).bind_to_uniform_block(0)
            self.program["Network"].binding = 0

    def _table(self, rows):
        """Rows uint32 [N, 1 or 2] or uint8 [N, 4] as a texture."""
        height = max(1, -(-len(rows) // WIDTH))
        padded = np.zeros((WIDTH * height, rows.shape[1]), rows.dtype)
        padded[: len(rows)] = rows
        kind = "f1" if rows.dtype == np.uint8 else "u4"
        texture = self.context.texture((WIDTH, height), rows.shape[1], padded.tobytes(), dtype=kind)
        texture.filter = self.context.NEAREST, self.context.NEAREST
        return texture

    def _of_field(self, field):
        """(textures by uniform, numbers by uniform) of a row of FIELD."""
        arrays, kind = self.asset.arrays, ("latent_", "latents0") if "latents" in self.asset.arrays else ("", "voxels")
        table_at, bits_at = int(field[f"{kind[0]}table_at"]), int(field[f"{kind[0]}bits_at"])
        log2 = int(field["latent_log2" if kind[0] else "table_log2"])
        table = arrays[f"{kind[0]}table"][table_at : table_at + (1 << log2)]
        bricks = int(table[:, 1].max())
        bits = arrays[f"{kind[0]}bits"][bits_at : bits_at + WORDS * bricks]
        return ({f"u_{kind[1]}_table": self._table(table), f"u_{kind[1]}_bits": self._table(bits)},
                {f"u_{kind[1]}_log2": log2, "u_salt": int(field["salt"])})

    def _set(self, values):
        for name, value in values.items():
            if name in self.program:
                self.program[name].value = value

    def draw(self, axes: np.ndarray, zoom: float) -> None:
        """One frame: right, up and forward float32 [3, 3], half the picture's side in radii."""
        self.target.use()
        self.target.clear(1.0, 1.0, 1.0, 0.0)
        self.context.enable_only(self.context.DEPTH_TEST | self.context.CULL_FACE)
        self._set({"u_zoom": zoom})
        self.program["u_axes"].write(np.ascontiguousarray(axes.T, np.float32).tobytes())
        for vertices, textures, numbers in self.fields:
            for unit, (name, texture) in enumerate((self.shared | textures).items()):
                texture.use(unit)
                self._set({name: unit})
            self._set(numbers)
            vertices.render()

    def picture(self) -> np.ndarray:
        """uint8 [side, side, 4], the first row on top."""
        side = self.target.width
        pixels = np.frombuffer(self.target.read(components=4, alignment=1), np.uint8).reshape(side, side, 4)[::-1].copy()
        pixels[..., 3] = np.where(pixels[..., 3] > 0, 255, 0)
        return pixels


def rows(inputs: Path, side: int, repeats: int) -> Iterator[dict[str, Any]]:
    """Rows {"key", "figures"}."""
    import moderngl

    context = moderngl.create_context(standalone=True, backend="egl")
    shaders = json.loads((inputs / "frames_glsl.json").read_text())
    for name in ASSETS:
        path = inputs / f"frames_{name}.npz.xz"
        if not path.exists():
            continue
        data, given = load_arrays(path), shaders[name]
        block = None if given["block"] is None else base64.b64decode(given["block"])
        frames = FragmentFrames(context, asset_of(data), given["shader"], block, side)
        taken, compared = [], {}
        for number, axes in enumerate(data["cameras"]):
            frames.draw(axes, 1.0)
            for _ in range(repeats):
                query = context.query(time=True)
                with query:
                    frames.draw(axes, 1.0)
                taken.append(query.elapsed * 1e-6)
            if number == int(data["reference_view"]) and side == int(data["reference_side"]):
                first, step = data["window_near"]
                picture = frames.picture()[first : side - first : step, first : side - first : step]
                compared = picture_psnr(picture, data["reference_near"])
        figures = {"frame_ms_median": round(float(np.median(taken)), 4), "frame_ms_95": round(float(np.percentile(taken, 95)), 4)}
        facts = {"timer": "OpenGL timer queries", "renderer": context.info["GL_RENDERER"], "side": side, "repeats": repeats}
        yield {"key": f"frames/{name.replace('_', '/')}/fragments", "figures": figures | facts | compared}


def main() -> None:
    """Command line."""
    inputs, *numbers = sys.argv[1:]
    side, repeats = (int(n) for n in [*numbers, *("2048", "20")[len(numbers) :]])
    for row in rows(Path(inputs), side, repeats):
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
