"""The jobs of a batch: one asset at one setting in a folder of its own, what it is known by, and whether it is finished."""

import hashlib
import inspect
import json
import os
from dataclasses import dataclass
from pathlib import Path

import texfcodec
from texfcodec.core.json_text import json_text
from tools.bench.conditions import EVALUATION, SAMPLE
from tools.bench.methods import find

SCHEMA = 1
LATER = {"seed", "maps", "lit", "pictures", "picture_size"}  # keys of an evaluation that it has not always had
JOB, ENCODED, METRICS, MISSING = "job.json", "encode.json", "metrics.json", "missing.json"
REPOSITORY = Path(__file__).resolve().parents[2]


@dataclass
class Job:
    """One asset at one setting. folder: for its files; facts: content of its job.json; path: the asset's file."""

    folder: Path
    facts: dict
    path: Path | None = None

    @property
    def name(self):
        return f"{self.facts['asset']}/{self.facts['setting']}"

    def metrics(self, keep_old=False):
        """Return the metrics of a finished job, or None. keep_old: whether metrics that other code has measured count."""
        return self._of_this(METRICS, keep_old)

    def row(self):
        """What MISSING says of this job, by this code: {"state": "missing" or "does not apply", "reason"}, or None."""
        return self._of_this(MISSING, False)

    def is_finished(self, keep_old=False):
        """Return whether nothing is left to do. A job that lacked a program is not finished: it is tried again."""
        row = self.row()
        return bool(self.metrics(keep_old)) or row is not None and row["state"] != "missing"

    def _of_this(self, name, keep_old):
        row = read_json(self.folder / name) or {}
        same = row.get("settings_sha256") == self.facts["settings_sha256"]
        return row if same and (keep_old or row.get("code") == self.facts["code"]) else None


def _identity(settled):
    """What tells a job from others. What an evaluation has not always had and is not asked for does not count."""
    evaluation = {key: value for key, value in settled["evaluation"].items() if key not in LATER or value != EVALUATION[key]}
    return settled | {"evaluation": evaluation}


def jobs_of(conditions, assets, out):
    """Return all Jobs of conditions (of read_conditions()), asset by asset. assets: {name: path}; out: folder for results."""
    code = {name: code_of(name, conditions["plugins"]) for name in {s["method"] for s in conditions["settings"]}}
    jobs, names = [], {}
    for given, path in assets.items():
        name, asset_sha256 = SAMPLE if given == SAMPLE else path.stem, _sha256(path.read_bytes())
        if name in names:
            raise SystemExit(f"two assets are called {name!r}: {names[name]} and {path}")
        names[name] = path
        for setting in conditions["settings"]:
            if given not in setting["assets"]:
                continue
            settled = {"schema": SCHEMA, "asset": name, "asset_sha256": asset_sha256, "evaluation": conditions["evaluation"],
                       **{key: setting[key] for key in ("setting", "group", "method", "options")}}
            facts = {**settled, "settings_sha256": _sha256(json.dumps(_identity(settled), sort_keys=True).encode()),
                     "code": code[setting["method"]], "package": texfcodec.__version__, "asset_path": str(path),
                     "plugins": conditions["plugins"]}
            jobs.append(Job(out / name / setting["setting"], facts, path))
    return jobs


def code_of(method, plugins):
    """Return 16 hexadecimal digits of a hash of what results depend on: sources of the package and the method, its version()."""
    coder = find(method, plugins)
    total = hashlib.sha256(coder.version().encode())
    for path in (*sorted((REPOSITORY / "texfcodec").rglob("*.py")), Path(inspect.getfile(type(coder)))):
        total.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]


def key_of(value):
    """Return 16 hexadecimal digits of a hash of a JSON-ready value."""
    return _sha256(json.dumps(value, sort_keys=True).encode())[:16]


def _sha256(data):
    return hashlib.sha256(data).hexdigest()


def read_json(path):
    """Return the content of a JSON file; None if it does not exist or is incomplete."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def write_json(path, value):
    """Write a value as a JSON file beside the path and rename it, so that a file of this name is always whole."""
    part = path.with_name(path.name + ".part")
    part.write_text(as_text(value), encoding="utf-8")
    os.replace(part, path)


def as_text(value):
    """Return the text of a JSON file with this value."""
    return json_text(value, indent=1) + "\n"
