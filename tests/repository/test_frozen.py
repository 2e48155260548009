"""The interfaces that docs/guide/versions.md freezes are those of tests/golden/interfaces.json. What is new is added by `python
tests/repository/test_frozen.py`, in the commit that brings it; what is there goes with a release whose first number rises."""

import dataclasses
import inspect
import json
import re
import sys
from importlib import import_module
from pathlib import Path

import texfcodec
from texfcodec import errors
from texfcodec.cli import console
from texfcodec.findings import FINDINGS
from texfcodec.sandbox import native
from texfcodec.validate.validate import validate

REPOSITORY = Path(__file__).resolve().parents[2]
GOLDEN = REPOSITORY / "tests" / "golden" / "interfaces.json"
TOOLS = {name: "evaluate" if name == "eval" else name for name in ("dec", "enc", "eval", "info", "render", "validate", "view")}
EXPORT = re.compile(r"^export (?:async )?(?:class|function|const) (\w+)|^export \{(\w+)\}", re.M)


def signature(function, name):
    return f"{name}({', '.join(inspect.signature(function).parameters)})"


def members(name, kind):
    """Public attributes of a class that is no exception's, functions with their parameters."""
    fields = {f.name for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    for member in sorted({*fields, *dir(kind)} - {*dir(Exception)}):
        if not member.startswith("_"):
            value = getattr(kind, member, None)
            yield signature(value, f"{name}.{member}") if inspect.isfunction(value) else f"{name}.{member}"


def python_names():
    for name in texfcodec.__all__:
        value = getattr(texfcodec, name)
        yield from [name, *members(name, value)] if inspect.isclass(value) else [signature(value, name)]


def flags():
    for name, function in TOOLS.items():
        for parameter in getattr(import_module(f"texfcodec.cli.{name}"), function).params:
            yield from (f"texf-{name} {word}" for word in (*parameter.opts, *parameter.secondary_opts) if word.startswith("-"))


def json_keys():
    """Keys at the top of what texf-info and texf-validate print of a stream; tests of the other tools hold theirs."""
    data = (REPOSITORY / "conformance" / "subset" / "texels" / "in.texf").read_bytes()
    outcomes = {"texf-info": texfcodec.inspect(data), "texf-validate": validate(data)}
    return [f"{tool} {key}" for tool, facts in outcomes.items() for key in facts]


def exports():
    """Entry points of the npm package, and those of their exports that js/README.md or the guide names in code."""
    pages = [REPOSITORY / "js" / "README.md", *(REPOSITORY / "docs" / "guide").glob("*.md")]
    code = [part for page in pages for part in re.findall(r"```.*?```|`[^`]+`", page.read_text(encoding="utf-8"), re.S)]
    named = {*re.findall(r"\w+", " ".join(code))}
    package = json.loads((REPOSITORY / "js" / "package.json").read_text(encoding="utf-8"))
    for entry, target in package["exports"].items():
        path = target["default"] if isinstance(target, dict) else target
        text = (REPOSITORY / "js" / path).read_text(encoding="utf-8") if path.endswith(".js") else ""
        yield from [entry, *(f"{entry} {a or b}" for a, b in EXPORT.findall(text) if a in named or b in named)]


def declarations():
    """Of native/texf.h, without comments and line breaks."""
    text = re.sub(r"/\*.*?\*/", "", (REPOSITORY / "native" / "texf.h").read_text(encoding="utf-8"), flags=re.S)
    body = text.split("visibility push(default)")[1].split("#pragma")[0]
    define, rest = re.search(r"#define .*", body).group(), re.sub(r"#define .*", "", body)
    return [define, *(" ".join(part.split()) for part in re.split(r";\n(?! )", rest) if part.strip())]


def interfaces():
    exits = {f"{name} {value}" for name, value in vars(errors).items() if name.startswith("EXIT_")}
    return {"python": [*python_names()], "flags": [*flags()], "exit codes": sorted(exits),
            "error codes": [f"{row.code} {row.exit_code}" for row in FINDINGS],
            "json": [f"schema {console.SCHEMA}", *json_keys()], "npm": [*exports()], "c": declarations()}


def test_frozen_interfaces_are_as_they_were():
    frozen, current = json.loads(GOLDEN.read_text(encoding="utf-8")), interfaces()
    assert frozen.keys() == current.keys()
    gone = {name: sorted({*rows} - {*current[name]}) for name, rows in frozen.items()}
    new = {name: sorted({*current[name]} - {*rows}) for name, rows in frozen.items()}
    assert not any(gone.values()), f"frozen until the first number of the version rises: {gone}"
    assert not any(new.values()), f"new, which this file adds when it is called as a program: {new}"
    assert native.INTERFACE == 1 and len(frozen["c"]) > 10


if __name__ == "__main__":
    sys.exit(GOLDEN.write_text(json.dumps(interfaces(), indent=1) + "\n", encoding="utf-8") and None)
