"""What a child process does in a job's folder: encode, or decode, compare and measure."""

import time
import traceback
from pathlib import Path

from texfcodec.errors import EXIT_DIFFERS, EXIT_SUPPORT
from tools.bench.jobs import ENCODED, JOB, METRICS, MISSING, code_of, read_json, write_json
from tools.bench.measures import measure_job
from tools.bench.methods import find
from tools.proof.memory import Memory

KNOWN_BY = ("schema", "asset", "setting", "group", "method", "options", "settings_sha256", "code", "package")


class Differs(Exception):
    """The decoder's values are not the encoder's."""


class OtherCode(Exception):
    """The code here is not that of the batch."""


def run_step(step, folder, asset, threads):
    """Run "encode" or "decode" of a job in this child process; return the exit code. folder: of the job; asset: its path."""
    folder = Path(folder)
    try:
        job = read_json(folder / JOB) | {"asset_path": asset, "threads": int(threads)}
        if code_of(job["method"], job["plugins"]) != job["code"]:
            raise OtherCode("the code here is not that of the batch: it has changed since, or is another version")
        (encode_step if step == "encode" else decode_step)(folder, job)
    except Exception as error:
        traceback.print_exc()
        return EXIT_DIFFERS if isinstance(error, Differs) else EXIT_SUPPORT if isinstance(error, OtherCode) else 1
    return 0


def encode_step(folder, job):
    """Encode a job's asset into its folder: the method's files and encode.json, or missing.json if a program is not installed or
    the method finds nothing to code."""
    from texfcodec.io.load import load
    from texfcodec.report import Report

    method, report = find(job["method"], job["plugins"]), Report()
    if reason := method.missing(job["options"]):
        return _write_row(folder, job, "missing", reason)
    method.warm_up(job["options"], job["threads"])
    memory, begin = Memory(), time.perf_counter()
    scene = load(job["asset_path"])
    loaded, processor = time.perf_counter(), time.process_time()
    try:
        facts = method.encode(scene, job["options"], folder, job["threads"], report)
    except LookupError as error:
        if type(error) is not LookupError:  # a key or an index that is not there is a fault of the method
            raise
        return _write_row(folder, job, "does not apply", str(error))
    seconds = {"total": round(time.perf_counter() - loaded, 6), "processor": round(time.process_time() - processor, 6),
               **report.seconds}
    write_json(folder / ENCODED, {"load_seconds": round(loaded - begin, 6), "seconds": seconds, "memory": memory.result(),
                                  "warnings": list(dict.fromkeys([*scene.warnings, *report.warnings])),
                                  "dropped": list(dict.fromkeys([*scene.dropped, *report.dropped])), "facts": facts})


def _write_row(folder, job, state, reason):
    write_json(folder / MISSING, {**{k: job[k] for k in KNOWN_BY}, "state": state, "reason": reason})


def decode_step(folder, job):
    """Decode a job, compare with the encoder's reconstruction, measure, and write metrics.json into its folder."""
    from texfcodec.io.load import load
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
    source, begin = load(job["asset_path"]), time.perf_counter()
    measured = measure_job(source, decoded, job, folder)
    write_json(folder / METRICS, {
        **{k: job[k] for k in KNOWN_BY},
        "bytes": facts.pop("bytes"), **measured, "facts": facts,
        "seconds": {"load": encoded["load_seconds"], "encode": encoded["seconds"], "decode": seconds,
                    "measure": round(time.perf_counter() - begin, 6)},
        "memory": {"encode": encoded["memory"], "decode": peaks}, "threads": job["threads"],
        "warnings": encoded["warnings"], "dropped": encoded["dropped"],
        "reconstruction_sha256": sent, "decoded_sha256": values})
