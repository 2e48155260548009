"""What a child process does in a job's folder: encode, or decode, compare and measure."""

import os
import signal
import threading
import time
import traceback
from pathlib import Path

from baselines import find
from texfcodec.errors import EXIT_DIFFERS
from tools.jobs import ENCODED, JOB, METRICS, code_of, read_json, write_json
from tools.measures import measure_job
from tools.memory import Memory


class Differs(Exception):
    """The decoder's values are not the encoder's."""


def run_step(step, folder):
    """The whole life of a child process; its exit code. It ends with its parent, whose end of stdin closes then."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    folder = Path(folder)
    try:
        job = read_json(folder / JOB)
        if code_of(job["method"], job["plugins"]) != job["code"]:
            raise RuntimeError("the code has changed since the batch began")
        (encode_step if step == "encode" else decode_step)(folder, job)
    except Exception as error:
        traceback.print_exc()
        return EXIT_DIFFERS if isinstance(error, Differs) else 1
    return 0


def _end_with_parent():
    os.read(0, 1)
    if hasattr(os, "killpg") and os.getpgid(0) == os.getpid():  # with whatever the method has started
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def encode_step(folder, job):
    """Codes the asset; leaves the method's files and encode.json."""
    from texfcodec.asset.load.files import load
    from texfcodec.report import Report

    method, report = find(job["method"], job["plugins"]), Report()
    method.warm_up(job["options"], job["threads"])
    memory, begin = Memory(), time.perf_counter()
    scene = load(job["asset_path"])
    loaded = time.perf_counter()
    facts = method.encode(scene, job["options"], folder, job["threads"], report)
    seconds = {"total": round(time.perf_counter() - loaded, 6), **report.seconds}
    write_json(folder / ENCODED, {"load_seconds": round(loaded - begin, 6), "seconds": seconds, "memory": memory.result(),
                                  "warnings": list(dict.fromkeys([*scene.warnings, *report.warnings])),
                                  "dropped": list(dict.fromkeys([*scene.dropped, *report.dropped])), "facts": facts})


def decode_step(folder, job):
    """Decodes, compares with the encoder's reconstruction, measures; leaves metrics.json."""
    from texfcodec.asset.load.files import load
    from texfcodec.report import Report

    method, report, encoded = find(job["method"], job["plugins"]), Report(), read_json(folder / ENCODED)
    method.warm_up(job["options"], job["threads"])
    memory, begin = Memory(), time.perf_counter()
    decoded = method.decode(folder, job["options"], job["threads"], report)
    seconds, peaks = {"total": round(time.perf_counter() - begin, 6), **report.seconds}, memory.result()
    facts, values = encoded["facts"], method.values_sha256(decoded)
    sent = facts.pop("reconstruction_sha256")
    if sent != values:
        raise Differs(f"the decoder's values are not those of the encoder's reconstruction: {values} is not {sent}")
    begin = time.perf_counter()
    measured = measure_job(load(job["asset_path"]), decoded, method.face_field(folder), job, folder)
    write_json(folder / METRICS, {
        **{k: job[k] for k in ("schema", "asset", "setting", "group", "method", "options", "settings_sha256", "code", "package")},
        "bytes": facts.pop("bytes"), **measured, "facts": facts,
        "seconds": {"load": encoded["load_seconds"], "encode": encoded["seconds"], "decode": seconds,
                    "measure": round(time.perf_counter() - begin, 6)},
        "memory": {"encode": encoded["memory"], "decode": peaks}, "threads": job["threads"],
        "warnings": encoded["warnings"], "dropped": encoded["dropped"],
        "reconstruction_sha256": sent, "decoded_sha256": values})
