"""The condition file of rate_points.py: read, checked, its lists multiplied out; and where its assets are."""

import itertools
import math
import re
import tomllib
from pathlib import Path

from tools.bench.methods import find

SAMPLE = "sample"
SUFFIXES = ("", ".glb", ".gltf", ".obj", ".ply")
EVALUATION = {"samples": 1_000_000, "seed": 0, "views": 16, "size": 2048, "ssim": False, "maps": False, "lit": False,
              "pictures": 0, "picture_size": 512}
LEAST = {"samples": 0, "seed": 0, "views": 0, "size": 16, "pictures": 0, "picture_size": 16}
KINDS = {bool: "true or false", int: "a whole number"}
NAME = re.compile(r"\w[\w.+-]*")


def read_conditions(path, changed=(), only=()):
    """Read and check a condition file; return {"assets", "plugins", "limit_seconds", "evaluation", "settings"}, or end the
    program with a sentence. changed: words KEY=VALUE that replace lines of [evaluation]; only: assets to keep, () for all."""
    try:
        with open(path, "rb") as file:
            given = tomllib.load(file)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SystemExit(f"{path}: {error}") from None
    try:
        _check_keys("the file", given, {"title", "assets", "plugins", "limit_seconds", "evaluation", "settings"})
        assets, plugins = _names(given, "assets"), _names({"plugins": [], **given}, "plugins")
        if not assets:
            raise ValueError("assets is empty")
        conditions = {"assets": assets, "plugins": [str(Path(path).parent.resolve() / p) for p in plugins],
                      "limit_seconds": _seconds(given.get("limit_seconds")),
                      "evaluation": _evaluation(given.get("evaluation", {}) | _changes(changed))}
        tables = given.get("settings")
        if not isinstance(tables, list) or not tables:
            raise ValueError("there is no [[settings]] table")
        conditions["settings"] = [s for number, table in enumerate(tables, 1) for s in _expanded(number, table, conditions)]
        for first, other in itertools.combinations(conditions["settings"], 2):
            if first["setting"] == other["setting"] and set(first["assets"]) & set(other["assets"]):
                raise ValueError(f"two settings are called {first['setting']!r}")
        if unknown := [name for name in only if name not in assets]:
            raise ValueError(f"{', '.join(unknown)} is none of its assets: {', '.join(assets)}")
        conditions["assets"] = [name for name in assets if name in only or not only]
    except ValueError as error:
        raise SystemExit(f"{path}: {error}") from None
    return conditions


def _check_keys(where, table, allowed):
    if not isinstance(table, dict):
        raise ValueError(f"{where} must be a table")
    for key in table:
        if key not in allowed:
            raise ValueError(f"{where} has an unknown key {key!r}; there are {', '.join(sorted(allowed))}")


def _names(table, key):
    values = table.get(key)
    if not isinstance(values, list) or not all(isinstance(v, str) and v for v in values):
        raise ValueError(f"{key} must be a list of names, as in {key} = [\"a\", \"b\"]")
    return values


def _seconds(value):
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf):
        raise ValueError(f"limit_seconds must be a number above 0, not {value!r}")
    return value


def _changes(words):
    """{key: value} of KEY=VALUE words, values as TOML has them."""
    try:
        return tomllib.loads("\n".join(words))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{' '.join(words)}: {error}") from None


def _evaluation(table):
    _check_keys("[evaluation]", table, set(EVALUATION))
    for key, value in table.items():
        kind = type(EVALUATION[key])
        if type(value) is not kind or kind is int and value < LEAST[key]:
            wanted = KINDS[kind] + (f", {LEAST[key]} or more" if kind is int else "")
            raise ValueError(f"[evaluation] {key} must be {wanted}, not {value!r}")
    return EVALUATION | table


def _expanded(number, table, conditions):
    """Settings [{"setting", "group", "method", "assets", "options"}] of one table; its lists are multiplied out."""
    where = f"[[settings]] number {number}"
    if not isinstance(table, dict) or not isinstance(table.get("name"), str):
        raise ValueError(f"{where} has no name")
    method, assets = table.get("method", "texf"), _names({"assets": conditions["assets"], **table}, "assets")
    for name in assets:
        if name not in conditions["assets"]:
            raise ValueError(f"{where}: {name!r} is none of the file's assets")
    try:
        known = find(method, conditions["plugins"]).options
    except LookupError as error:
        raise ValueError(f"{where}: {error}") from None
    options = {k: v for k, v in table.items() if k not in ("name", "group", "method", "assets")}
    _check_keys(f"{where} ({table['name']!r})", options, set(known))
    lists, settings = {k: v if isinstance(v, list) else [v] for k, v in options.items()}, []
    for key, values in lists.items():
        if not values or not all(isinstance(v, str | int) or isinstance(v, float) and math.isfinite(v) for v in values):
            raise ValueError(f"{where}: {key} must be text, a number, true, false or a list of these, not {options[key]!r}")
    for values in itertools.product(*lists.values()):
        chosen = dict(zip(options, values, strict=True))
        try:
            name, group = (str(table.get(key, default)).format(**chosen) for key, default in (("name", ""), ("group", method)))
        except (LookupError, AttributeError, ValueError) as error:
            raise ValueError(f"{where}: name and group may only use {{...}} for a key of the table, not {error}") from None
        if not NAME.fullmatch(name):
            raise ValueError(f"{where}: the name {name!r} is no folder name of letters, digits and . _ + -")
        settings.append({"setting": name, "group": group, "method": method, "assets": assets, "options": chosen})
    return settings


def find_assets(names, folders, out):
    """Find assets in folders; return ({name as given: path}, names not there). "sample" is written into out if missing."""
    paths, missing = {}, []
    for name in names:
        places = [folder / (name + suffix) for folder in folders for suffix in SUFFIXES]
        path = _sample(out) if name == SAMPLE else next((p for p in places if p.is_file()), None)
        if path is None:
            missing.append(name)
        else:
            paths[name] = path.resolve()
    return paths, missing


def _sample(out):
    path = out / SAMPLE / "source.glb"
    if not path.exists():
        from texfcodec.demo.asset import write_sample

        path.parent.mkdir(parents=True, exist_ok=True)
        write_sample(path)
    return path
