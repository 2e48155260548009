"""The words of every text that a user may read: help, findings, and the literals of warnings, remarks, errors and result lines.

A literal of the package is a text where it has two words or more and is not a docstring: more than users see, but nothing less.
Rules that need a whole sentence look at help and findings alone, where sentences are whole.
"""

import ast
import importlib
import re
from functools import cache
from pathlib import Path

import pytest

from texfcodec.findings import FINDINGS

PACKAGE = Path(__file__).resolve().parents[2] / "texfcodec"
TOOLS = ("enc", "dec", "info", "render", "eval", "validate", "view")
MOST_WORDS, MEDIAN_WORDS = 30, 17  # of a sentence; the first for each, the second for all of a kind

# Phrases that only this house uses, and what to write instead.
PRIVATE = {
    r"\b(?:was|were|is|are|not|been) (?:asked|told)\b|\basked (?:for|texels|or not)\b|\bas asked\b": "requested, referenced",
    r"\b(?:ask|asks|asking) (?:the|for|at|a|any)\b": "query, request, or the surface references",
    r"\b(?:is|are|was|of) none\b|\bnone any more\b": "is not a ..., are NaN",
    r"(?<!there )\bis no (?!longer\b|more\b)\w+": "is not a ...",
    r"\bwhole numbers?\b": "integer",
    r"\bmine\b": "the noun itself",
    r"\bgo(?:es)? over\b|\bwent over\b": "exceed, cover",
    r"\bc(?:a|o)me out\b": "has, results in",
    r"\bas ever\b": "unchanged",
    r"\bpassed over\b": "skipped",
    r"\bha(?:s|ve) no part in\b": "does not apply to",
    r"\bexclude each other\b": "cannot be combined",
    r"\btakes? (?:its|their|the) place\b": "is used instead",
    r"\b(?:is|are) there (?:already|twice|more than once)\b": "already exists, is repeated",
    r"\bwhat (?:is|was|were) (?:made|coded|written|named|given|said)\b": "the noun itself",
    r"\b(?:some|no|every)body\b|\bwhoever\b": "name the person or program",
    r"\bmend(?:ed|s)?\b": "correct, repair",
    r"\bstrangers?\b": "unknown sources",
    r"\bin light\b": "lit, with lighting",
    r"\bgo(?:es)? together\b|\bgo(?:es)? with\b": "match, can be combined",
    r"\bleft to\b|\ball the same\b|\bneed be\b": "say it in plain words",
    r"\bdata (?:are|have|end|go)\b|\bmetadata are\b": "data is, has, ends: the singular",
    r"\bsays? nothing\b|\bsaid nothing\b": "has no effect, no output",
}
# Words of two spellings: the house's, unless the word stands in a name (glTF's baseColor, a flag, a path, code in quotes).
SPELLINGS = {"color": "colour", "gray": "grey", "center": "centre", "quantization": "quantisation", "quantize": "quantise",
             "normalize": "normalise", "optimize": "optimise", "recognize": "recognise", "serialize": "serialise",
             "neighbor": "neighbour", "behavior": "behaviour", "voxelize": "voxelise", "meter": "metre"}
BARE_WORDS = re.compile(r"(?<![\w./:<>'\"=_-])[A-Za-z]+(?![\w./:<>'\"=_(-]*[\w/<>'\"=_(-])")


# Checks: text in, findings out.


def private_words(text):
    return [f"{hit.group()!r}: write {instead}" for pattern, instead in PRIVATE.items()
            if (hit := re.search(pattern, text, re.IGNORECASE))]


def other_spellings(text):
    return [f"{word!r}: write {house}" for other, house in SPELLINGS.items() for word in BARE_WORDS.findall(text)
            if re.fullmatch(other + "(?:s|d|ed|ing)?", word.lower())]


def sentences_of(text):
    """Sentences, each up to its full stop, without what is a table: the default, the exit codes, the rate points."""
    text = re.sub(r"\[default[^\]]*\]|Exit codes.*|\bThe paper's rate points.*", "", " ".join(text.split()), flags=re.DOTALL)
    return [part for part in re.split(r"(?<=[.!?])\s+", text) if part.strip()]


def long_sentences(text):
    words = {sentence: len(sentence.split()) for sentence in sentences_of(text)}
    return [f"{count} words: {sentence}" for sentence, count in words.items() if count > MOST_WORDS]


def unfinished_help(text):
    """Help of an option begins with a capital, a flag or a codec's name and ends with a full stop before its default."""
    text = re.sub(r"[\s\b]*\[default[^\]]*\]$", "", text.strip())  # click keeps the lines of a paragraph that begins with \b
    return [] if re.fullmatch(r"(?:[A-Z]|--|\w+: [A-Z]).*\.", text, re.DOTALL) else [f"not a sentence: {text}"]


def unplain_finding(text):
    """Texts of findings are printed between others: no capital of a sentence, no full stop at the end."""
    first = text.split()[0]
    return ["begins with a capital or ends with a full stop"] if text.endswith(".") or (first.istitle() and len(first) > 1
                                                                                       and first not in NAMES) else []


NAMES = {"Draco"}
FOREIGN = {"in light"}  # looked for in what pycollada says


# The texts.


def literal_texts(tree):
    """(line, text) of every literal with two words or more; {} in place of what an f-string fills in."""
    docstrings = {id(node.body[0].value) for node in ast.walk(tree)
                  if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and node.body
                  and isinstance(node.body[0], ast.Expr)}
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        text = _text_of(node)
        if text and id(node) not in docstrings | inner and len(re.findall(r"[A-Za-z]{2,}", text)) > 1 and " " in text.strip():
            yield node.lineno, text


def _text_of(node):
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


@cache
def package_texts():
    """{place: text} of the package."""
    return {f"{path.relative_to(PACKAGE).as_posix()}:{line}: {text}": text for path in sorted(PACKAGE.rglob("*.py"))
            for line, text in literal_texts(ast.parse(path.read_text(encoding="utf-8")))}


@cache
def help_texts():
    """{place: text} of the seven tools: of every option, and of the tool itself under its name alone."""
    out = {}
    for name in TOOLS:
        module = importlib.import_module(f"texfcodec.cli.{name}")
        command = getattr(module, "evaluate" if name == "eval" else name)
        out[f"texf-{name}"] = command.help
        out |= {f"texf-{name} {(option.opts or [option.help])[-1]}": option.help for option in command.params
                if getattr(option, "help", None)}
    return out


def finding_texts():
    return {f"{finding.code} {kind}": getattr(finding, kind) for finding in FINDINGS for kind in ("text", "remedy")}


def found_in(check, texts):
    return [f"{place}: {finding}" for place, text in texts.items() if text not in FOREIGN for finding in check(text)]


# The package as it stands.


@pytest.mark.parametrize("check", [private_words, other_spellings])
def test_texts_have_no(check):
    found = found_in(check, package_texts() | help_texts() | finding_texts())
    assert not found, "\n".join(found)


def test_no_sentence_of_help_or_findings_is_long():
    found = found_in(long_sentences, help_texts() | finding_texts())
    assert not found, "\n".join(found)


@pytest.mark.parametrize("texts", [help_texts, finding_texts])
def test_half_of_the_sentences_are_short(texts):
    lengths = sorted(len(sentence.split()) for text in texts().values() for sentence in sentences_of(text))
    assert len(lengths) > 100 and lengths[len(lengths) // 2] <= MEDIAN_WORDS


def test_help_of_every_option_is_a_sentence():
    found = found_in(unfinished_help, {place: text for place, text in help_texts().items() if " " in place})
    assert not found, "\n".join(found)


def test_findings_are_plain():
    found = found_in(unplain_finding, finding_texts())
    assert not found, "\n".join(found)


def test_the_texts_are_all_there():
    assert len(package_texts()) > 1000 and len(help_texts()) > 120 and len(finding_texts()) == 2 * len(FINDINGS)
    assert {"texf-enc", "texf-enc --batch", "texf-view --limit"} <= help_texts().keys()
    assert any("there is not enough memory" in text for text in package_texts().values())


# The checks themselves, against what they must catch and must let pass.


WORDS = "word " * MOST_WORDS


@pytest.mark.parametrize("check, bad, good", [
    (private_words,
     ["voxels are asked for", "ask the field as metrics do", "its numbers are none any more", "{} is no view: front",
      "all but mine", "its budget goes over", "it came out worse", "the geometry is coded as ever",
      "an unknown unit is passed over", "--qp has no part in codec 3dntc", "lossless and qp exclude each other",
      "white takes its place", "a file is there already",
      "compare what was made", "nobody reads the output", "mend the line", "files from strangers", "PSNR in light",
      "materials do not go together", "it is left to chance", "the data end here", "it said nothing", "N is a whole number"],
     ["the file is not a mesh", "the budget no longer holds it", "there is no view", "the unit is skipped", "the data ends",
      "a browser was found", "one of them", "choose none", "the value is left out", "no body of text"]),
    (other_spellings, ["the color of a face", "Colors at vertices.", "quantization", "normalized values"],
     ["the colour of baseColorFactor", "attribute COLOR_0 is left out", "'color' is not an object", "--color sets it",
      "docs/color.md", "scene.color", "parameter", ""]),
    (long_sentences, [WORDS + "more."], [WORDS.strip() + ". " + WORDS.strip() + ".", WORDS + "[default: a b c]"]),
    (unfinished_help, ["draw back faces", "Draw back faces", "back faces."],
     ["Draw back faces too.", "Folder for results.", "3dntc: Number of steps.  [default: 3]"]),
    (unplain_finding, ["The file is empty", "the file is empty."], ["the file is empty", "Draco cannot code the mesh"]),
])
def test_check_catches_and_lets_pass(check, bad, good):
    assert [len(check(text)) for text in bad + good] == [1] * len(bad) + [0] * len(good)


def test_a_docstring_is_no_text_and_an_f_string_is_one():
    tree = ast.parse('"""Doc string."""\ndef f(x):\n    """Doc string."""\n    g(f"at {x} bytes", "one", "two words")')
    assert [text for _, text in literal_texts(tree)] == ["at {} bytes", "two words"]
