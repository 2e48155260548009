from tools.bench import pairs


def row(wall, content, size=10):
    return {"wall": wall, "processor": 2 * wall, "memory": 1 << 20, "bytes": size, "sha256": content}


def test_the_page_tells_medians_and_what_differs():
    rows = {name: {"encode": {"before": row(10.0, "a"), "after": row(wall, "a")},
                   "save": {"before": row(4.0, "a", 7), "after": row(2.0, glb, 9)}}
            for name, wall, glb in (("cube", 5.0, "a"), ("fan", 8.0, "b"), ("hat", 9.0, "a"))}
    text = " ".join(pairs.page_of({"commits": ["0123", "4567"], "rate": "r03", "machine": "2 cores", "rows": rows}).split())
    assert "commit 0123 before, 4567 after; rate r03" in text
    assert "takes 80 % of the time by the wall clock and 80 % of the processor's, a decode to GLB 50 % and 50 %" in text
    assert "| fan | 10 | a | 10.0, 8.0 | 20.0, 16.0 | the same | 4.0, 2.0 | 8.0, 4.0 | +2 bytes | 2.00 | 1 |" in text
    assert text.count("bytes |") == 2  # a heading, and the GLB of the fan
