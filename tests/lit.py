"""Points under the daylight, for every test of the shading."""

import numpy as np

from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.material import shade
from texfcodec.render.material_effects import ShadingTable
from texfcodec.render.shading_points import ShadingPoints
from texfcodec.scene.scene import Material

COUNT = 300


def material_of(parameters=None, channels=(), unlit=False):
    """A material; a parameter of one component may be a number; channels: names of its maps."""
    full = {name: tuple(np.atleast_1d(value).tolist()) for name, value in (parameters or {}).items()}
    return Material(parameters=full, maps=dict.fromkeys(channels, -1), unlit=unlit)


def table_of(parameters=None, channels=(), unlit=False):
    """The table of one material."""
    return ShadingTable([material_of(parameters, channels, unlit)])


def directions(count=COUNT, seed=0, steepest=0.05):
    """Normals and views [count, 3] float32, unit, the views above the surface."""
    rng = np.random.default_rng(seed)
    n, v = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in rng.normal(size=(2, 8 * count, 3)))
    n = np.where(np.einsum("mk,mk->m", n, v)[:, None] < 0, -n, n)
    chosen = np.flatnonzero(np.einsum("mk,mk->m", n, v) > steepest)[:count]
    return n[chosen].astype(np.float32), v[chosen].astype(np.float32)


def lit(environment=DAYLIGHT, channels=None, base=(0.7, 0.5, 0.3), seen=None, unlit=False, **parameters):
    """Radiance [M, 3] of one material. channels: values by name, one per point or one for all."""
    n, v = directions() if seen is None else seen
    fill = lambda value: np.broadcast_to(np.asarray(value, np.float32), (len(n), np.shape(value)[-1]))
    values = {name: fill(value) for name, value in {"base_colour": base, **(channels or {})}.items()}
    table = table_of(parameters, channels or (), unlit)
    return shade(ShadingPoints(material=np.zeros(len(n), np.int64), normal=n, view=v, values=values), table, environment)
