"""The tutorial notebook runs from its first cell to its last, and says what its text says."""

import json
from pathlib import Path

import pytest
from pages import write_vase

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "guide" / "tutorial.ipynb"


@pytest.fixture(scope="module")
def cells():
    return json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]


def test_cells_hold_no_outputs(cells):
    assert [cell["id"] for cell in cells if cell.get("outputs") or cell.get("execution_count")] == []


def test_every_cell_runs(cells, monkeypatch):
    names = {}
    monkeypatch.setattr("texfcodec.demo.asset.write_sample", write_vase)
    for cell in (cell for cell in cells if cell["cell_type"] == "code"):
        exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    sizes = [len(names["made"].data), (names["folder"] / "back.glb").stat().st_size, names["source"].stat().st_size]
    assert max(sizes[:2]) < sizes[2] and names["refused"].code == "TXF-S02"
    assert len(names["texf"].faces) > 10
