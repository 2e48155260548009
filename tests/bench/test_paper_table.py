"""The page of results: whom our curves stand against, and what the page says of it."""

from tools.bench import paper_table
from tools.bench.paper_table import ANCHOR, AUTO, VERTEX_ANCHOR, _evaluation, asset_lines, by_asset_lines, paper_lines


def rows_of(group, asset, factor, uv=None, geometry=None):
    """Three points of a curve with `factor` times the bytes that an equal one has. geometry: its bytes, where others."""
    made, geometry = [], 500 * factor if geometry is None else geometry
    for number, y in enumerate((30.0, 34.0, 38.0)):
        texture = factor * 1000 * 2**number
        parts = {"geometry": geometry, "texture": texture - (uv or 0)} | ({} if uv is None else {"uv": uv})
        made.append({"asset": asset, "group": group, "setting": f"s_r0{number + 1}", "facts": {"supports": ["voxels"]},
                     "bytes": {"total": geometry + texture} | parts, "psnr_3d": {"y": y, "rgb": y},
                     "image": {"psnr": {"y": y, "rgb": y}, "ssim": 0.9 + number / 50}})
    return made


def cells(lines, first):
    """The cells of the line that begins with a cell."""
    return next([cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith(f"| {first} |"))


def test_vertex_colours_stand_against_vertex_colours_and_textures_against_uvs():
    rows = [*rows_of(AUTO, "cloth", 1), *rows_of(ANCHOR, "cloth", 2, uv=900),
            *rows_of(AUTO, "fish", 3), *rows_of(ANCHOR, "fish", 9, uv=900), *rows_of(VERTEX_ANCHOR, "fish", 2)]
    lines = asset_lines(rows, {"cloth": {"unused": 0.25}})
    cloth, fish = cells(lines, "cloth"), cells(lines, "fish")
    assert cloth[4:7] == ["900", "voxels", "-50.0"] and fish[4:7] == ["no UVs", "voxels", "+50.0"]
    assert cloth[-1] == "TexF; UVs are 22% of the rival's middle point; 25% of its texels are never shown"
    assert fish[-1] == "the rival"


def test_what_auto_saves_on_the_mesh_counts_in_its_part_and_not_in_the_papers():
    rows = [*rows_of(AUTO, "bball_0001", 1, geometry=0), *rows_of(ANCHOR, "bball_0001", 1, uv=900, geometry=5000)]
    assert float(cells(asset_lines(rows, {}), "bball_0001")[6]) < -50
    assert float(cells(paper_lines(rows, ((AUTO, "TexF", (0, 0)),), ANCHOR), AUTO)[3]) == 0


def test_the_page_says_how_many_points_of_ours_are_by_the_present_code(monkeypatch):
    monkeypatch.setattr(paper_table, "code_of", lambda method, plugins: f"{method} now")
    monkeypatch.setattr(paper_table, "state_of", lambda root: "0123abcd")
    image = {"views": 16, "size": 1024}
    rows = [{"method": method, "code": code, "image": image}
            for method, code in (("texf", "texf now"), ("texf_baked", "old"), ("uv", "old"))]
    assert "3 points, **1 of 2 of ours** by the code of commit 0123abcd" in _evaluation(rows)
    assert "2 points, all 1 of ours by" in _evaluation([rows[0], rows[2]])


def test_rows_of_the_paper_that_were_not_run_are_said():
    lines = paper_lines([*rows_of("ours", "bball_0001", 1), *rows_of("uv", "bball_0001", 2, uv=1)],
                        (("ours", "TexF", (-1, 2)), ("theirs", "Serialized", (112, 21))), "uv")
    assert cells(lines, "ours")[2:5] == ["-1 / +2", "-50.0", "-50.0"]
    assert cells(lines, "theirs")[2:] == ["+112 / +21", *["not run"] * 5]


def test_every_group_has_a_figure_for_every_asset_that_both_have():
    rows = [*rows_of(ANCHOR, "fish", 2.0), *rows_of(ANCHOR, "cloth", 2.0), *rows_of("ours", "cloth", 1.0),
            *rows_of("theirs", "fish", 3.0)]
    lines = by_asset_lines(rows, ANCHOR)
    assert cells(lines, "group") == ["group", "cloth", "fish"]
    assert cells(lines, "ours") == ["ours", "-50.0", "-"] and cells(lines, "theirs") == ["theirs", "-", "+50.0"]
