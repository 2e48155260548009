"""tools/bench/first_run.py: what is compiled is seen, and the page sums it up."""

from tools.bench import first_run


def test_the_page_has_rooms_and_the_longest():
    own = {"texfcodec.field.voxelise._touched": 0.5, "texfcodec.field.voxelise._slot": 0.25, "numba.np.arrayobj.impl": 0.004}
    found = {tool: {"wall": 3.0, "kernels": own, "files": 4} for tool in ("texf-enc", "texf-dec")}
    lines = first_run.page_of(found, "a/cube.glb", "0123abcd", 1).splitlines()
    assert "| texf-enc | 3.0 | 0.8 | 3 | 4 |" in lines
    assert "| field | 0.75 | 0.75 |" in lines and not any("arrayobj" in line or "numba.np" in line for line in lines)
    assert "| field.voxelise._touched | 0.50 | 0.50 |" in lines and not any("_slot" in line for line in lines)


def test_a_kernel_of_two_is_seen_with_seconds_of_its_own(tmp_path):
    """In a process of its own, so that numba is new."""
    import json
    import os
    import subprocess
    import sys

    (tmp_path / "made.py").write_text("import numba\n@numba.njit\ndef inner(v): return v + 1\n@numba.njit\n"
                                      "def outer(v): return inner(v)\nassert outer(1) == 2\n")
    told = tmp_path / "told.json"
    subprocess.run([sys.executable, first_run.__file__, "--watch", told, "made"], check=True, cwd=tmp_path,
                   env=os.environ | {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(first_run.ROOT)))})
    kernels = json.loads(told.read_text())["kernels"]
    assert {name.rsplit(".", 1)[1] for name in kernels} == {"inner", "outer"} and min(kernels.values()) > 0
