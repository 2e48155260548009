"""The pages of README and docs/guide as tests read them: commands, links, anchors, and the sentences of their prose."""

import re
import shlex
import statistics
from pathlib import Path

import numpy as np
from mesh_files import Builder, encoded
from shapes import painted_sphere
from walls import smooth_image, wall

REPOSITORY = Path(__file__).resolve().parents[1]
GUIDE = REPOSITORY / "docs" / "guide"
README = REPOSITORY / "README.md"
TOOLS = ("texf-enc", "texf-dec", "texf-info", "texf-validate", "texf-render", "texf-eval", "texf-view")

_FENCE = re.compile(r"^(```|~~~).*?^\1[^\n]*$", re.M | re.S)
_BLOCK = re.compile(r"<!-- .*? -->\n.*?<!-- end -->|<!--.*?-->", re.S)
_LINK = re.compile(r"(!?)\[([^]]*)\]\(([^)\s]+)\)")
_ITEM = re.compile(r"^\s*(?:[-*]|\d+\.) ", re.M)
_ASIDE = re.compile(r"^(?:#|\||!|    |\s*[-*] `).*$", re.M)
_SENTENCE_END = re.compile(r"(?<=[.!?])[)\"']?\s+(?=[\"'(`*A-Z0-9]|texf|three\.js)")


def write_vase(path):
    """A wall with a picture and a ball with vertex colours as GLB, in place of the demo asset, which takes ten times as long."""
    scene, ball, builder = wall(smooth_image(256, 256, 3), n=16), painted_sphere(), Builder()
    image = scene.textures[0].image[..., :3] // 2 + np.random.default_rng(0).integers(0, 24, (256, 256, 3), np.uint8)
    corners = [one.positions[one.faces].reshape(-1, 3).astype(np.float32) for one in (scene, ball)]
    builder.primitive(corners[0], np.arange(len(corners[0]), dtype=np.uint16), scene.corner_uv.reshape(-1, 2).astype(np.float32),
                      material=builder.material(builder.texture(encoded(image))))
    colours = builder.accessor(np.clip(ball.corner_color, 0, 1).reshape(-1, 4))
    builder.primitive(corners[1] + np.float32(2), np.arange(len(corners[1]), dtype=np.uint16), material=builder.material(),
                      attributes={"COLOR_0": colours})
    Path(path).write_bytes(builder.glb())


def guide_pages():
    """The files of docs/guide, by name."""
    return sorted(GUIDE.glob("*.md"))


def indented_lines(text):
    """Lines of indented code, without their indentation; those of fenced code are not among them."""
    lines, before, code = [], "", False
    for line in _FENCE.sub("", text).splitlines():
        code = line.startswith("    ") and (code or not before.strip())  # a block begins behind an empty line
        if code:
            lines.append(line[4:])
        before = line
    return lines


def commands_of(text):
    """The commands of a page, as lists of words: indented lines that begin with one of the tools or with python -m texfcodec."""
    starts = ("python -m texfcodec", *(f"{name} " for name in TOOLS))
    return [shlex.split(line, comments=True) for line in indented_lines(text) if line.startswith(starts)]


def links_of(text):
    """(target, anchor or "") of every link that is not one to another site; links in code are none."""
    text = re.sub(r"`[^`\n]*`", "", _FENCE.sub("", text))
    for _, _, target in _LINK.findall(text):
        if not re.match(r"[a-z]+:", target):
            path, _, anchor = target.partition("#")
            yield path, anchor


def anchors_of(text):
    """The anchors that a page's headings have where Markdown is shown."""
    headings = re.findall(r"^#{1,6} (.*)$", _FENCE.sub("", text), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def sentences(text):
    """Sentences of a page's prose; a piece of code is a word, a link as many as it shows. No code, tables, headings, generated
    blocks, lists of options."""
    text = _ASIDE.sub("", _BLOCK.sub("", _FENCE.sub("", text)))
    text = re.sub(r"`[^`]*`", "X", _LINK.sub(r"X\2", _ITEM.sub("\n\n", text)))
    parts = [part for block in re.split(r"\n\s*\n", text) for part in _SENTENCE_END.split(" ".join(block.split()))]
    return [part for part in parts if words_in(part)]


def words_in(sentence):
    """Words of a sentence: what has a letter or a digit."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def median_length(text):
    """Median of the words of a page's sentences, 0 where there are none."""
    return statistics.median([words_in(sentence) for sentence in sentences(text)] or [0])
