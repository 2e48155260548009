"""Measurements: rate_points.py and the rooms it walks through, what makes tables of its results, and the makers of vectors.

conditions -> jobs -> batch -> steps, each step a process of its own. baselines/ is imported by that name alone, here and by
plug-ins, so that there is one table of methods; therefore this folder stands on the path.
"""

import sys

if __path__[0] not in sys.path:
    sys.path.insert(0, __path__[0])
