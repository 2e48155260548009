"""JSON trees and text with something odd in them."""

import copy
import re
from typing import Any

from fuzz.choices import ODD_NUMBERS, Choices

ODD_VALUES = (None, True, False, 0, 1, -1, 2, 3, 1.5, -0.0, 1e308, "", "a", "\x00", "\ud800", "../..", [], {}, [0], [[]],
              {"a": 0}, [0, 1, 2], 4294967295, 1 << 70, "1e999")
ODD_WORDS = ("0", "-1", "1", "2", "1e999", "-1e999", "nan", "inf", "-inf", "1e-320", "4294967296", "99999999999999999999", "",
             "x", "/", "//", "#", "\\", "\"", "\x00", "\u00e9", "1/2/3", "0x10", "+", "1.", ".5", "-", "1 2", "\n", "\t", "<",
             ">", "&#0;", "]]>")
_WORDS = re.compile(r"(\s+|[<>=\"'/,;{}\[\]])")


def paths_of(tree, path=()):
    """Where everything in a tree is."""
    yield path
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, child in children:
        yield from paths_of(child, (*path, key))


def bend_tree(tree: Any, choices: Choices) -> Any:
    """A copy of a JSON tree with one place left out, doubled, swapped with another, or with something odd in it."""
    tree = copy.deepcopy(tree)
    path = choices.pick(list(paths_of(tree)))
    if not path:
        return choices.pick(ODD_VALUES) if choices.flag(16) else tree
    holder = tree
    for key in path[:-1]:
        holder = holder[key]
    last, kind = path[-1], choices.whole(0, 6)
    if kind == 0:
        del holder[last]
    elif kind == 1 and isinstance(holder, list):
        holder.insert(last, copy.deepcopy(holder[last]))
    elif kind == 2:
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        other = choices.pick(keys)
        holder[last], holder[other] = holder[other], holder[last]
    elif kind == 3 and isinstance(holder[last], int | float):
        holder[last] += choices.whole(0, 4) - 2
    elif kind == 4:
        holder[last] = choices.pick(ODD_NUMBERS)
    elif kind == 5 and isinstance(holder, dict):
        holder[choices.pick(("index", "uri", "extensions", "a"))] = holder.pop(last)
    else:
        holder[last] = copy.deepcopy(choices.pick(ODD_VALUES))
    return tree


def bend_text(text: str, choices: Choices) -> str:
    """The text with one word, or one line, left out, doubled, moved or replaced by something odd."""
    if choices.flag(3):
        lines = text.split("\n")
        a, b, kind = choices.whole(0, len(lines) - 1), choices.whole(0, len(lines) - 1), choices.whole(0, 3)
        if kind == 0:
            lines[a], lines[b] = lines[b], lines[a]
        elif kind == 1:
            lines.insert(a, lines[b])
        elif kind == 2:
            del lines[a]
        else:
            lines[a] = lines[a][: choices.whole(0, len(lines[a]))]
        return "\n".join(lines)
    words = _WORDS.split(text)
    at, kind = choices.whole(0, len(words) - 1), choices.whole(0, 4)
    if kind == 0:
        words[at] = words[choices.whole(0, len(words) - 1)]
    elif kind == 1:
        words.insert(at, words[at])
    elif kind == 2:
        del words[at]
    elif kind == 3 and words[at].lstrip("-").isdigit():
        words[at] = str(int(words[at]) + choices.whole(0, 4) - 2)
    else:
        words[at] = choices.pick(ODD_WORDS)
    return "".join(words)
