"""A budget of lines for each room: growth is a decision that a commit makes as an edit of this table with a reason."""

import pytest
from test_house import REPOSITORY, tracked_files

SOURCES = {".py", ".js", ".mjs", ".ts", ".html", ".css", ".c", ".cpp", ".h", ".hpp", ".cu"}
LONGEST_LINE = 2000  # a file with a longer one is a bundle, which does not count

# Folders, the deepest that holds a file counts it: the most lines of all their files together.
BUDGETS = {
    ("texfcodec",): 54_560,  # target 42,500, with its JavaScript; 9,500 are docstrings; scenes took 2,400, speed 500,
    # memory of large meshes 100, the native library 150, a GLB of texel fields without kernels 80, tilesets 200,
    # values of generators 1,230: voxels, arrays, functions, channels at vertices, a mesh without a search;
    # 55 of edges sorted once for meshes of a million faces, 80 of their GLB in half the time,
    # 30 of imports of a file parted, 25 of the order of refusals, 20 of what a node of COLLADA looks at
    ("js", "native"): 10_700,  # 1,500 came with coded meshes of a glTF on a page, expand() and its fuzzer; 220 with its atlas,
    # 195 with vectors and threads, 20 with a shared library, 660 with textures in blocks for the card,
    # 800 with a reader of Draco's data in place of Draco's sources, 210 with a module with vectors and its heap,
    # 430 with glTF-Transform, Babylon.js, PlayCanvas, a service worker and their tests,
    # 180 with an atlas in typed arrays, five times faster or more, and its test, 20 with the order of refusals
    ("tools",): 13_786,  # target 10,500; 130 are of scenes, 100 of wheels for platforms, 30 of zips of add-ons,
    # 200 of ladders of speed, each tool at its own efforts, 375 of bytes on the card, 365 of time to picture,
    # 115 of sparse voxels, 150 of what a file is in Blender, beside its source, 125 of viewers,
    # 85 of streams of public models that every release decodes to the same values,
    # 260 of the picture that README opens with and of the figures of docs/design
    ("tools/gpu",): 3_100,  # came with fitting, frames and decoding on a GPU, whose page must be made again
    ("conformance",): 9_474,  # target 7,500; 600 are of glTF files with streams and what expands them,
    # 55 of streams of everyday size in place of their hashes, and of the promise for glTF files, 20 of what mutants left,
    # 310 of streams with two faults and of the order in which they are refused,
    # 450 of vectors for what careful readings left open, their claims and checksums of levels, 140 of what misreadings left
    ("tests",): 42_550,  # 165 are of frozen interfaces and of what later editions add; 90 of tilesets;
    # 460 are of sparse voxels, a writer of .vxz and fuzz targets of both readers;
    # 45 are of faulty vectors with no fault but one and of levels;
    # 10 are of vectors that are promised and of 16-bit grey, 15 of the page of recorded points, which a sweep alone had read,
    # 55 are of time to picture and of modules, 25 of blocks in Chromium, 150 of the native library,
    # 55 of ladders and vectors made again;
    # 2,056 are of scenes, 50 of trials that end early; 2,600 came from tools/proof; target 29,000
}


def lines_of(data):
    """Lines of a file's bytes; none of a bundle's."""
    lines = data.splitlines()
    return 0 if any(len(line) > LONGEST_LINE for line in lines) else len(lines)


def room_of(path, rooms=BUDGETS):
    """The folders that a path counts for; None for one that is outside of all."""
    inside = [(len(folder), folders) for folders in rooms for folder in folders if path.startswith(folder + "/")]
    return max(inside)[1] if inside else None


def test_no_room_has_more_lines_than_its_budget():
    counts = dict.fromkeys(BUDGETS, 0)
    for path in tracked_files():
        room = room_of(path.relative_to(REPOSITORY).as_posix())
        if room and path.suffix in SOURCES:
            counts[room] += lines_of(path.read_bytes())
    assert min(counts.values()) > 0, counts
    over = {room: count for room, count in counts.items() if count > BUDGETS[room]}
    assert not over, f"{over} lines: make them fewer, or raise the budget here with the reason beside it"


@pytest.mark.parametrize("path, room", [
    ("tools/gpu/run.py", ("tools/gpu",)), ("tools/gpus.py", ("tools",)), ("tests/web/test_x.py", ("tests",)),
    ("README.md", None), ("testsuite/x.py", None),
])
def test_a_file_counts_for_the_deepest_folder(path, room):
    assert room_of(path) == room


def test_a_bundle_does_not_count():
    assert lines_of(b"a\nb\n" + b"x" * LONGEST_LINE) == 3 and lines_of(b"a\n" + b"x" * (LONGEST_LINE + 1)) == 0
