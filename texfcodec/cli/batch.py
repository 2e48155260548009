"""texf-enc --batch: encodes every asset of a catalogue, each in a process of its own, here or on a Dask cluster."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .. import __version__
from ..core import cleanup
from ..core.json_text import json_ready, json_text
from ..errors import EXIT_DIFFERS, EXIT_IO, InputError, LimitError, SupportError, TexfError
from ..options import default_threads
from ..precompile import ALL, first_run
from ..report import plural
from . import interrupts
from . import tileset as tiles
from .catalogue import Asset, read_catalogue, words_given
from .console import Console, printable
from .flags import file_names, flag_of, number
from .passed_over import PassedOver
from .results import Results, sha256_of
from .stream_names import SCENE, SUFFIX
from .totals import Totals, losses_in_words

SCHEMA = 1
FLAGS = ("batch", "batch_out", "suffix", "jobs", "scheduler", "limit_seconds", "memory_limit")
STREAM, ANSWER = "stream", "answer.json"  # the former without its suffix
MOST_JOBS = 256
NAMES = {"shell_complete": file_names}


def batch_flags(option: Callable) -> Callable[[Callable], Callable]:
    """Return a decorator that adds the flags of --batch to a click command. batch_of() then takes their values out of the
    choices. option: decorator factory of an OptionGroup, in place of click.option."""
    table = {
        "batch": ("CATALOGUE", {"help": "Encode every mesh in a folder and its subfolders, or in a manifest. Requires --out.",
                                **NAMES}),
        "batch_out": ("DIR", {"help": "Folder for streams and results.", **NAMES}),
        "suffix": (None, {"type": click.Choice([SUFFIX, SCENE]),
                          "help": "Suffix of the streams. .glb: a glTF keeps its scene, as OUT.glb does; other formats become "
                                  f".texf.  [default: {SUFFIX}]"}),
        "jobs": ("N", number(1, MOST_JOBS, "Encode N assets at a time, with cores / N threads each; 1..256.  [default: 1]")),
        "scheduler": ("ADDRESS", {"help": "Encode on the Dask cluster at tcp://HOST:PORT."}),
        "limit_seconds": ("S", number(0.001, 1e9, "Maximum time per asset, in seconds.")),
        "memory_limit": ("BYTES", number(1 << 20, 1 << 62, "Maximum memory of the process that encodes an asset, in bytes "
                                                           "(Linux only).")),
    }

    def decorate(function):
        for name, (metavar, keywords) in reversed(table.items()):
            function = option(flag_of(name), name, metavar=metavar, **keywords)(function)
        return function

    return decorate


def batch_of(choices: dict[str, Any], source: str | None, out: str | None) -> dict[str, Any] | None:
    """Take the values of the batch flags out of choices (all flags of texf-enc by name) and return them; None without --batch.
    source, out: the arguments INPUT and OUT.texf. Raises click.UsageError for a combination that is not allowed."""
    flags = {name: choices.pop(name) for name in FLAGS}
    given = [flag_of(name) for name, value in flags.items() if value is not None]
    if flags["batch"] is None:
        if given:
            raise click.UsageError(f"{' and '.join(given)} can only be used with --batch")
        if source is None:
            raise click.UsageError("Missing argument 'INPUT'")
        return None
    if source is not None or out is not None:
        raise click.UsageError("--batch takes neither INPUT nor OUT.texf; --out names its folder")
    if flags["batch_out"] is None:
        raise click.UsageError("--batch needs --out DIR")
    if flags["jobs"] is not None and flags["scheduler"] is not None:
        raise click.UsageError("--jobs cannot be combined with --scheduler: the cluster's threads set the number of jobs")
    return flags


def encode_batch(console: Console, flags: dict[str, Any], checkpoint: str | None, dry_run: bool) -> int:
    """Encode all assets of a catalogue and return the exit code: 0, EXIT_DIFFERS if an asset failed, EXIT_IO if the disk is
    full. flags: as batch_of() returns them; checkpoint, dry_run: other flags, which a batch refuses."""
    from ..batch.folders import only_run, work_room
    from ..batch.task_progress import progress

    if dry_run or checkpoint is not None:
        raise click.UsageError(f"{'--dry-run' if dry_run else '--checkpoint'} cannot be combined with --batch")
    words = words_given(click.get_current_context(), (*FLAGS, "as_json", "quiet", "dry_run"))
    out, source = Path(flags["batch_out"]), Path(flags["batch"])
    passed_over = PassedOver()
    tileset = _tileset_of(console, flags, source, out)
    assets = tileset.assets if tileset else read_catalogue(source, out, console.note, passed_over, flags["suffix"] or SUFFIX)
    interrupts.Talk.kept = True
    with only_run(out), work_room(out) as room:
        batch = Batch(console, out, words, flags)
        todo = [asset for asset in assets if not batch.is_finished(asset)]
        if console.quiet:
            batch.run(todo, room, lambda name, line, is_bad: None)
        else:
            with progress(len(todo)) as show:
                batch.run(todo, room, show)
        if tileset:
            _finish(tileset, out, set(batch.failed))
    console.note(batch.summary(len(assets), len(todo)))
    for line in (*passed_over.line(), *batch.totals.lines()):
        console.note(line)
    if console.as_json:
        totals = batch.totals.facts() | {"skipped": passed_over.counts()}
        click.echo(json_text({"schema": SCHEMA, "totals": totals}), file=console.results)
    cleanup.finish()
    return EXIT_IO if batch.is_full else EXIT_DIFFERS if batch.failed else 0


def _tileset_of(console, flags, source, out):
    """The Tileset of a catalogue that ends in .json, else None."""
    if source.suffix.lower() != tiles.SUFFIX:
        return None
    if flags["suffix"] is not None:
        raise click.UsageError("--suffix cannot be combined with a tileset: its contents stay scenes")
    tileset = tiles.Tileset(source, console.note)
    tileset.check_out(out)
    return tileset


def _finish(tileset, out, failed):
    from ..io.output_files import as_input_error

    try:
        tileset.finish(out, failed)
    except OSError as error:
        raise as_input_error(error, out) from None


class Batch:
    """A run of texf-enc --batch. out: folder for results; words: flags for every asset, as words; flags: as batch_of() returns
    them. failed: names of assets that failed; is_full: whether a disk was full; totals: Totals so far."""

    def __init__(self, console: Console, out: Path, words: tuple[str, ...], flags: dict[str, Any]) -> None:
        self.console, self.out, self.words, self.flags = console, out, words, flags
        self.results, self.is_full, self.begin = Results(out), False, time.perf_counter()
        self.failed: list[str] = []
        self.totals = Totals()

    def is_finished(self, asset: Asset) -> bool:
        """Return whether an earlier run has encoded an asset already, from the same files and options. Its line of that run's
        results is then counted in totals and printed."""
        row = self.results.finished(asset, self._words(asset))
        if row is not None:
            self.totals.add(row)
            self._tell(row | {"passed_over": True})
        return row is not None

    def _words(self, asset):
        return (*self.words, *asset.words)

    def run(self, assets: list[Asset], room: Path, show: Callable[[str, str, bool], None]) -> None:
        """Encode assets in processes on this machine, or on the Dask cluster of --scheduler, and report each as it ends. room:
        folder for the attempts; show(name, line, is_bad): displays the end of an asset, is_bad if it failed."""
        from ..batch.local import run_here

        self.show, self.assets = show, {asset.out: asset for asset in assets if asset.error is None}
        for asset in assets:
            if asset.error is not None:
                self._fail(asset, asset.error)
        workers = self.flags["jobs"] or 1
        tasks = [self._task(asset, max(default_threads() // workers, 1)) for asset in self.assets.values()]
        if not tasks:
            return
        if self.flags["scheduler"]:
            from ..batch.cluster import run_there

            run_there(tasks, self.flags["scheduler"], room, self._ended, self.console.note)
        else:
            self._warm_up()
            run_here(tasks, workers, room, self._ended)

    def _warm_up(self):
        """Compiles the kernels once, instead of in many processes at the same time."""
        from ..batch.children import WARM_UP, Caps, Children

        line = first_run(ALL)
        if line:
            self.console.note(line)
            Children().run(WARM_UP, subprocess.DEVNULL, subprocess.DEVNULL, Caps(default_threads()))

    def _task(self, asset, threads):
        from ..batch.tasks import Task, package_code

        words = [word.replace("{", "{{").replace("}", "}}") for word in self._words(asset)]
        command = ("-m", "texfcodec.cli.enc", "{input}", "{folder}/" + _stream(asset), "--json", "--threads", "{threads}", *words)
        return Task(name=asset.out, commands=(("encode", command),), input=asset.path.absolute(), out=ANSWER, threads=threads,
                    package=package_code(), memory=self.flags["memory_limit"], seconds=self.flags["limit_seconds"])

    def _ended(self, task, outcome, folder):
        from ..batch.tasks import DONE, FULL, is_full
        from ..io.output_files import as_input_error

        asset = self.assets[task.name]
        if outcome.state == FULL:
            self.is_full = True
            return self._fail(asset, InputError("TXF-O03", outcome.reason))
        facts = _answer_of(folder)
        if outcome.state != DONE or facts is None or "error" in facts:
            return self._fail(asset, _error_of(outcome, facts, task))
        try:
            row = self._kept(asset, folder, facts)
        except OSError as error:
            self.is_full = self.is_full or is_full(error)
            return self._fail(asset, as_input_error(error, self.out / asset.out))
        self.totals.add(row)
        self._tell(row)
        self._show(asset, f"{row['stream']['bytes']} bytes, {facts['seconds']['total']:.2f} s{losses_in_words(facts)}", False)

    def _kept(self, asset, folder, facts):
        """Moves the stream to its place, then appends its line and returns it."""
        names, stream, target = facts["source"].pop("names"), folder / _stream(asset), self.out / asset.out
        home = os.path.dirname(names[0])  # the first is the asset itself, wherever it was read
        files = {Path(os.path.relpath(name, home)).as_posix() for name in names}
        row = {**self._row(asset), "files": {name: sha256_of(asset.path.parent / name) for name in sorted(files)},
               "stream": {"bytes": stream.stat().st_size, "sha256": sha256_of(stream)}, "result": facts}
        target.parent.mkdir(parents=True, exist_ok=True)
        cleanup.rename_all([(stream, target)])
        self.results.append(row)
        return row

    def _row(self, asset):
        return {"schema": SCHEMA, "asset": asset.name, "out": asset.out, "options": list(self._words(asset)),
                "package": __version__}

    def _fail(self, asset, error):
        fault = error.as_dict() | {"exit_code": error.exit_code} if isinstance(error, TexfError) else error
        row = {**self._row(asset), "error": json_ready(fault)}
        self.failed.append(asset.name)
        self.totals.add(row)
        try:
            self.results.append(row)
        except OSError:  # a full disk: what has failed is tried again without a line as well
            self.is_full = True
        self._tell(row)
        self._show(asset, f"failed: {fault['code']}: {fault['message']}", True)

    def _show(self, asset, text, is_bad):
        name = printable(asset.name)
        self.show(name, f"{name}: {printable(text)}", is_bad)

    def _tell(self, row):
        click.echo(json_text(row), file=self.console.results)

    def summary(self, count: int, tried: int) -> str:
        """Return one line about the whole batch: how many assets were encoded, were there already, and failed. count: number of
        assets; tried: those of them that this run had to encode."""
        seconds = time.perf_counter() - self.begin
        return (f"{plural(count, 'asset', 'assets')}: {tried - len(self.failed)} encoded in {seconds:.0f} s, {count - tried} "
                f"already encoded, {len(self.failed)} failed; see {self.out / 'results.jsonl'}")


def _stream(asset):
    """The name of an asset's stream in the folder of an attempt; its suffix chooses the format."""
    return STREAM + Path(asset.out).suffix.lower()


def _answer_of(folder):
    """The one JSON object that the encoder printed, or None."""
    try:
        return json.loads((folder / ANSWER).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _error_of(outcome, facts, task):
    """The encoder's own error as a dict, or the batch's."""
    from ..batch.tasks import OVERDUE

    if facts is not None and "error" in facts:
        return facts["error"]
    if outcome.state == OVERDUE:
        return LimitError("TXF-L12", "encoding took longer than the limit allows", allowed=task.seconds)
    return SupportError("TXF-C07", "the process that encoded the asset ended without a result: "
                                   f"{outcome.reason}", memory_limit=task.memory)
