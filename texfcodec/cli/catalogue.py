"""Catalogues of texf-enc --batch: the mesh files of a folder, or those of a manifest, each with the name of its stream."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from ..batch.folders import WORK
from ..errors import InputError
from ..io.formats import SUFFIXES
from .passed_over import SYSTEM_FOLDERS, PassedOver, is_system_file
from .stream_names import SCENE, SUFFIX, given_names, short_name, with_own_names

RESULTS = "results.jsonl"  # in the folder for results
KEYS = ("path", "out", "options")
NOT_OF_AN_ASSET = {"batch", "checkpoint", "dry_run", "help", "jobs", "json", "limit_seconds", "memory_limit", "out",
                   "quiet", "scheduler", "suffix", "version", "warmup"}  # flags that are no part of how an asset is coded


@dataclass(frozen=True)
class Asset:
    """A mesh to encode. name: its path in the catalogue, which the results repeat; path: its file; out: path of its stream,
    relative to the folder for results; words: flags for it alone, as words of a command line; error: why it cannot be encoded,
    or None; is_named: whether a manifest chose out."""

    name: str
    path: Path
    out: str
    words: tuple[str, ...] = ()
    error: InputError | None = None
    is_named: bool = False


def read_catalogue(source: Path, out: Path, note: Callable[[str], object], passed_over: PassedOver | None = None,
                   suffix: str = SUFFIX) -> list[Asset]:
    """Return the assets of a catalogue: the mesh files of a folder and its subfolders, sorted by name, or those of a manifest,
    in its order. Each gets a unique name for its stream (stream_names.py).

    source: the folder or manifest; out: the folder for results, which is skipped; note(text): reports skipped links;
    passed_over: gets the files that are not meshes; suffix: of the streams that the catalogue does not name.
    Raises InputError TXF-I57, and TXF-I01 for a catalogue that does not exist.
    """
    try:
        if source.is_dir():
            assets = _of_folder(source, out, note, passed_over if passed_over is not None else PassedOver())
        else:
            assets = _of_toml(source) if source.suffix.lower() == ".toml" else _of_lines(source)
        assets = [asset if asset.is_named or asset.error else replace(asset, out=short_name(Path(asset.name), suffix))
                  for asset in assets]
        assets = _without_overwriting(with_own_names(assets, given_names(out / RESULTS)), out)
    except ValueError as error:  # of TOML, UTF-8, or what is in there
        raise InputError("TXF-I57", "the manifest cannot be read", path=str(source), reason=str(error)[:200]) from None
    if not assets:
        raise InputError("TXF-I57", f"the batch contains no asset; files of meshes end in {' '.join(SUFFIXES)}", path=str(source))
    return assets


def _without_overwriting(assets, out):
    """Return the assets, with an error for those whose stream would replace an asset's file."""
    inputs = {os.path.realpath(asset.path) for asset in assets}
    return [replace(asset, error=InputError("TXF-O07", "the output would overwrite an input file", path=asset.out))
            if asset.error is None and os.path.realpath(out / asset.out) in inputs else asset for asset in assets]


def _of_folder(top, out, note, passed_over):
    assets = []

    def unreadable(error):
        name = Path(error.filename).relative_to(top).as_posix()
        reason = InputError("TXF-I03", "the folder cannot be read", path=error.filename, reason=error.strerror)
        assets.append(Asset(name, Path(error.filename), name, error=reason))

    for place, folders, names in os.walk(top, onerror=unreadable):
        for name in [name for name in folders if os.path.islink(os.path.join(place, name))]:
            note(f"{os.path.join(place, name)} is a link to a folder and is skipped")
        for name in sorted(SYSTEM_FOLDERS.intersection(folders)):
            passed_over.add((Path(place) / name).relative_to(top).as_posix() + "/", is_system=True)
        folders[:] = sorted(name for name in folders if name not in {WORK, *SYSTEM_FOLDERS}
                            and (Path(place) / name).resolve() != out.resolve())
        for name in sorted(names):
            path = Path(place) / name
            inside = path.relative_to(top)
            if name.lower().endswith(SUFFIXES) and not is_system_file(name):
                assets.append(Asset(inside.as_posix(), path, short_name(inside)))
            else:
                passed_over.add(inside.as_posix())
    return sorted(assets, key=lambda asset: asset.name)


def _read(source):
    _check(not source.name.lower().endswith(SUFFIXES), "this file is a mesh, not a manifest; encode it without --batch")
    try:
        return source.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError("TXF-I01", "the file does not exist", path=str(source)) from None
    except OSError as error:
        raise InputError("TXF-I03", "the file cannot be read", path=str(source), reason=error.strerror) from None


def _of_lines(source):
    lines = [line.strip() for line in _read(source).split("\n")]
    return [Asset(line, source.parent / line, short_name(Path(line))) for line in lines if line and not line.startswith("#")]


def _of_toml(source):
    given = tomllib.loads(_read(source))
    tables, own = given.pop("asset", []), given.pop("options", {})
    _check(not given and isinstance(tables, list), "a manifest may contain only [[asset]] tables and [options]")
    return [_of_table(table, own, source.parent) for table in tables]


def _of_table(table, own, folder):
    _check(isinstance(table, dict) and isinstance(table.get("path"), str), "an [[asset]] has no path")
    strange = sorted(table.keys() - set(KEYS))
    _check(not strange, f"an [[asset]] has unknown keys: {', '.join(strange)}; it may have path, out and options")
    name, out = table["path"], table.get("out", short_name(Path(table["path"])))
    _check(isinstance(out, str) and out.lower().endswith((SUFFIX, SCENE)) and not Path(out).is_absolute()
           and ".." not in Path(out).parts,
           f"out of {name} must be a relative path that ends in {SUFFIX} or {SCENE} and stays in the results folder")
    options = table.get("options", {})
    _check(isinstance(own, dict) and isinstance(options, dict), "options must be a table of names and values")
    return Asset(name, folder / name, Path(out).as_posix(), words_of(own | options), is_named="out" in table)


def _check(is_fine, text):
    if not is_fine:
        raise ValueError(text)


def words_of(options: dict[str, Any]) -> tuple[str, ...]:
    """Return options of a manifest as words of a command line: {"qp": 24, "measure": true, "limit": ["faces=9", "voxels=9"]}
    becomes --qp 24 --measure --limit faces=9 --limit voxels=9. Raises ValueError for values of other types."""
    words = []
    for name, value in options.items():
        _check(name.replace("-", "_") not in NOT_OF_AN_ASSET, f"{name} is not an option of an asset")
        values = value if isinstance(value, list) else [value]
        _check(isinstance(value, str | int | float) or (values and all(isinstance(item, str) for item in values)),
               f"the option {name} must be text, a number, true or false, or a list of texts")
        flag = "--" + name.replace("_", "-")
        for item in values:
            words += [flag] if item is True else [] if item is False else [flag, str(item)]
    return tuple(words)


def words_given(context: click.Context, without: tuple[str, ...]) -> tuple[str, ...]:
    """Return the flags that the user gave on a command line as words, except parameters whose names are in `without`."""
    words: list[str] = []
    for parameter in context.command.params:
        name = str(parameter.name)
        given = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if not given or name in without or not isinstance(parameter, click.Option):
            continue
        value, flag = context.params[name], parameter.opts[0]
        values = value if parameter.multiple else [value]
        words += [flag] if parameter.is_flag else [word for item in values for word in (flag, str(item))]
    return tuple(words)
