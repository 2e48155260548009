"""Targets of glTF files whose meshes are in streams: expand() of coded files, and the encoder's plan of their sources. The files
are those of conformance/container/."""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from unittest.mock import patch

from gltf_scenes import tree_of, with_tree

from conformance.make.containers import HOME, SOURCES
from fuzz.choices import Choices, edited
from fuzz.seeds import SMALL
from fuzz.trees import bend_tree
from texfcodec.core.json_text import json_text
from texfcodec.decoder import decode_stream
from texfcodec.encoder.container.encode import encode_document
from texfcodec.errors import TexfError
from texfcodec.io.container.expand import expand_bytes
from texfcodec.io.container.layout import is_container, streams_of
from texfcodec.io.container.references import references
from texfcodec.io.gltf.document import open_document
from texfcodec.io.parts import Notes
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.report import Report

OPTIONS = EncodeOptions(limits=SMALL)


@lru_cache(maxsize=1)
def _coded():
    """Good coded files, the smallest first, without the one that takes an atlas, which a child process makes."""
    names = [path.name for path in HOME.iterdir() if path.name != "voxels" and not path.name.startswith("faulty_")]
    return sorted(((HOME / name / "in.glb").read_bytes() for name in names), key=len)


@lru_cache(maxsize=1)
def _sources():
    """(source, streams that its parts are coded in) of these files."""
    streams = {name: streams_of(open_document((HOME / name / "in.glb").read_bytes(), Path(), Notes())) for name in SOURCES}
    return [(source().glb(), streams[name]) for name, source in SOURCES.items()]


def _bent(data, choices):
    """A GLB with odd places in its JSON or among its bytes."""
    root = tree_of(data)
    for _ in range(choices.whole(0, 3)):
        root = bend_tree(root, choices)
    begin = 20 + int.from_bytes(data[12:16], "little")
    return with_tree(data[:begin] + (edited(data[begin:], choices) if choices.flag(4) else data[begin:]), root)


@lru_cache(maxsize=64)
def _decoded(stream, *_):
    """A stream's Texf, decoded once: other targets are about streams."""
    return decode_stream(stream, DecodeOptions(limits=SMALL), Report())


def _expanded(data):
    """The expanded file, whose references are checked."""
    result = expand_bytes(data, Path(), _decoded, "png")
    if result is not data:
        root = open_document(result, Path(), Notes()).root
        assert not is_container(root) and all(reference.target >= 0 for _, reference in references(root))


def container(data: bytes) -> None:
    """A coded file, expanded."""
    choices = Choices(data)
    _expanded(_bent(choices.pick(_coded()), choices))


@dataclass
class _Stream:
    """What the encoder returns, as far as encode_document() reads it."""

    data: bytes
    sizes: dict = field(default_factory=lambda: {"total": 0, "other": 0})


def scene_file(data: bytes) -> None:
    """A source, coded with the streams of the file that it was bent from, and expanded; nodes, scenes and cameras stay."""
    choices = Choices(data)
    source, streams = choices.pick(_sources())
    source, rest = _bent(source, choices), list(streams)
    with patch("texfcodec.decoder.decode_stream", _decoded):
        result = encode_document(source, Path(), OPTIONS, Report(), lambda *_: _Stream(rest.pop(0) if rest else streams[0])).data
    kept = [[json_text(open_document(file, Path(), Notes()).root.get(kind), ensure_ascii=False).encode("utf-8", "replace")
             for kind in ("nodes", "scenes", "cameras")] for file in (source, result)]
    assert kept[0] == kept[1], kept
    try:
        _expanded(result)
    except TexfError:  # the streams are those of another scene
        pass
