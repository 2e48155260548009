"""Hard cases with a bound each: what is stressed, why the bound holds, and how near to it seeds and a search come.

case.py: a case, its draws and the search; lattice.py, surfaces.py, transform.py, entropy.py, fits.py, looks.py, neural.py,
floats.py: cases, by what they stress; table.py: all of them; page.py, plots.py: docs/reports/stability.md; __main__.py: the
command. They measure against the reference decoder, fractions, or a formula; a test runs the table, too.
"""

import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]
for folder in (REPOSITORY / "tests", REPOSITORY):  # shapes and oracles, which pytest finds by itself
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
