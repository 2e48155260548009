"""Batches of jobs: a small asset, what their folders hold, a wait until something is so, and the rows that they leave."""

import os
import time
from pathlib import Path

import numpy as np
from shapes import painted_sphere

REPOSITORY = Path(__file__).resolve().parents[1]


def write_ball(folder):
    """ball.ply, a small sphere with vertex colours."""
    scene = painted_sphere(8)
    colours = np.zeros((len(scene.positions), 3), np.int64)
    colours[scene.faces] = np.rint(255 * np.clip(scene.corner_color[..., :3], 0, 1))
    head = ["ply", "format ascii 1.0", f"element vertex {len(scene.positions)}", *(f"property float {c}" for c in "xyz"),
            *(f"property uchar {c}" for c in ("red", "green", "blue")), f"element face {len(scene.faces)}",
            "property list uchar int vertex_indices", "end_header"]
    rows = [f"{x:.6f} {y:.6f} {z:.6f} {r} {g} {b}" for (x, y, z), (r, g, b) in zip(scene.positions, colours, strict=True)]
    (folder / "ball.ply").write_text("\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in scene.faces)]) + "\n")


def stamps(out):
    """{ASSET/SETTING: time at which it was finished}."""
    return {p.parent.relative_to(out).as_posix(): p.stat().st_mtime_ns for p in out.glob("*/*/metrics.json")}


def environment():
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")]))}


def wait_for(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def children_in(out):
    """Command lines of live processes that work on a job of this folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
        except OSError:
            continue
        if b"--step" in words and any(word.startswith(os.fsencode(out)) for word in words):
            found.append(words)
    return found


def metrics(asset, group, number, total, y, rgb=None):
    return {"asset": asset, "group": group, "setting": f"{group}{number}", "package": "0", "code": "c", "bytes":
            {"total": total, "geometry": 100, "attributes": total - 100}, "psnr_3d": {"y": y, "rgb": rgb or y - 1, "samples": 9},
            "image": None, "seconds": {"encode": {"total": 1.5}, "decode": {"total": 0.5}},
            "memory": {"encode": {"peak": 2e8}, "decode": {"peak": None}}, "warnings": ["a", "b"]}
