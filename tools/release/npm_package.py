"""The npm package: packed in a clean copy, and tried in an empty folder."""

import json
import shutil
from pathlib import Path

from tools.release.clean_copy import REPOSITORY, run

VECTOR = REPOSITORY / "conformance" / "subset" / "texels" / "in.texf"
QUIET = ("--no-audit", "--no-fund", "--no-package-lock", "--ignore-scripts", "--loglevel=error")
PROGRAM = """
import {readFileSync} from 'node:fs';
import {decode, dispose} from 'texf';
import {decodeWith} from 'texf/engine';
const asset = await decode(readFileSync(process.argv[2]));
console.log(typeof decodeWith, asset.fields[0].keys.length);
dispose();
"""


def pack(copies: list[Path], out: Path) -> list[Path]:
    """One .tgz for each copy of the tree, in out/0, out/1, ... The compiler of the declarations is installed once."""
    packed, modules = [], None
    for number, copy in enumerate(copies):
        package = copy / "js"
        shutil.copy(copy / "LICENSE", package)  # npm packs it without being asked
        if modules is None:
            run("npm", "install", *QUIET, folder=package)
        else:
            modules.rename(package / "node_modules")
        modules = package / "node_modules"
        folder = out / str(number)
        folder.mkdir(parents=True)
        run("npm", "pack", "--loglevel=error", "--pack-destination", folder, folder=package)
        packed += folder.glob("*.tgz")
    return packed


def try_package(archive: Path, folder: Path) -> None:
    """Installs it in an empty folder, imports it in node and decodes a vector. SystemExit where that fails."""
    folder.mkdir()
    (folder / "package.json").write_text(json.dumps({"private": True, "type": "module"}), encoding="utf-8")
    (folder / "program.js").write_text(PROGRAM, encoding="utf-8")
    run("npm", "install", *QUIET, archive, folder=folder)
    said = run("node", "program.js", VECTOR, folder=folder).decode().split()
    if len(said) != 2 or said[0] != "function" or not int(said[1]) > 0:
        raise SystemExit(f"the npm package decodes no vector; it said {said}")
