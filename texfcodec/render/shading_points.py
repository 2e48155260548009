"""Points to be shaded: as a caller passes them, and a run of them as the terms read them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .lobes import LEAST, dot
from .material_effects import LARGEST, ShadingTable

UNBOUNDED = frozenset({"emissive", "thickness"})  # channels whose final values may be above 1


@dataclass(kw_only=True)
class ShadingPoints:
    """M surface points in view. Directions are of any length; one that is zero or not finite counts as the view, and such a view
    as +z.

    Parameters
    ----------
    material : int64 [M]
        Indices into the table.
    normal : float32 [M, 3]
        World, shading normals with the normal map.
    view : float32 [M, 3]
        From the point to the eye.
    values : dict of str to float32 [M, C]
        By channel, final (ShadingTable.final), linear. A channel that is absent has ShadingTable.constant everywhere; in a
        channel that is present, the caller fills in the constant for materials without a map. NaN and negative numbers count as
        0, numbers above 1 as 1 (emissive and thickness as LARGEST).
    tangent : float32 [M, 4], optional
        World and handedness, read only for anisotropy.
    coat_normal : float32 [M, 3], optional
        Of the clear coat, to which glTF does not apply the base's normal map; without it the coat takes normal.
    """

    material: np.ndarray
    normal: np.ndarray
    view: np.ndarray
    values: dict[str, np.ndarray] = field(default_factory=dict)
    tangent: np.ndarray | None = None
    coat_normal: np.ndarray | None = None


class ShadedSurface:
    """A run of points whose materials use the same effects: float32, one column per point.

    normal, view: [3, m] unit; cosine: [m] between them, signed; nv: the same, at least LEAST; base: [3, m]; metallic, roughness:
    [m].
    """

    def __init__(self, points: ShadingPoints, table: ShadingTable, chosen: slice | np.ndarray) -> None:
        self._points, self._table, self._chosen = points, table, chosen
        self.material = points.material[chosen]
        self.base = self.value("base_colour")

    def stand(self) -> None:
        """Reads the inputs that every lit point needs beyond its colour."""
        up = np.zeros((3, len(self.material)), np.float32)
        up[2] = 1
        self.view = unit(self._points.view[self._chosen], up)
        self.normal = unit(self._points.normal[self._chosen], self.view)
        self.cosine = dot(self.normal, self.view)
        self.nv = np.maximum(self.cosine, LEAST)
        self.metallic, self.roughness = self.scalar("metallic"), self.scalar("roughness")
        self.sky_share: np.ndarray | np.float32 = np.float32(1)

    def value(self, name: str) -> np.ndarray:
        """Return a channel's values that shading uses, [C, m]. name: of the channel."""
        given = self._points.values.get(name)
        rows = self._table.constant(name, self.material) if given is None else given[self._chosen]
        columns = np.ascontiguousarray(rows.T, np.float32)
        return np.fmin(np.fmax(columns, np.float32(0)), np.float32(LARGEST if name in UNBOUNDED else 1))

    def scalar(self, name: str) -> np.ndarray:
        """Return the values that shading uses of a channel of one component, [m]. name: of the channel."""
        return self.value(name)[0]

    def parameter(self, name: str) -> np.ndarray:
        """Return the value of a material parameter at each point, [C, m]. name: of the parameter."""
        return self._table.values[name][self.material].T

    def coat_normal(self) -> np.ndarray:
        """Unit normals [3, m] of the clear coat."""
        given = self._points.coat_normal
        return self.normal if given is None else unit(given[self._chosen], self.view)

    def tangents(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit tangent and bitangent [3, m], orthogonal to the normal; any such pair where the points have no usable tangent."""
        given = self._points.tangent
        n = self.normal
        side = _across(n)
        if given is None:
            return side, cross(n, side)
        columns = np.ascontiguousarray(given[self._chosen].T, np.float32)
        raw = unit(columns[:3].T, np.zeros_like(n))
        flat = raw - dot(n, raw) * n
        tangent = np.where(dot(flat, flat) > 1e-6, flat, side)
        tangent /= np.sqrt(dot(tangent, tangent))
        return tangent, cross(n, tangent) * np.where(columns[3] < 0, np.float32(-1), np.float32(1))


def unit(rows: np.ndarray, instead: np.ndarray) -> np.ndarray:
    """Scale vectors to length 1 and transpose them to columns.

    Parameters
    ----------
    rows : float [m, 3]
        Vectors.
    instead : float32 [3, m]
        Columns for rows that are zero or not finite.

    Returns
    -------
    float32 [3, m]
        The columns.
    """
    columns: np.ndarray = np.ascontiguousarray(rows.T, np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        square = dot(columns, columns)
        odd = ~((square > 1e-20) & (square < 1e20))
        columns = columns / np.sqrt(np.where(odd, np.float32(1), square))
    if odd.any():
        place = np.flatnonzero(odd)
        exact = rows[place].astype(np.float64)
        length = np.linalg.norm(np.where(np.isfinite(exact), exact, 0), axis=1)
        good = np.isfinite(exact).all(axis=1) & (length > 0)
        exact = np.divide(exact, length[:, None], out=instead[:, place].T.astype(np.float64), where=good[:, None])
        columns[:, place] = exact.T
    return columns


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products a x b of columns.

    Parameters
    ----------
    a, b : float32 [3, M]
        Vectors.

    Returns
    -------
    float32 [3, M]
        The products.
    """
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _across(n):
    """A unit direction [3, m] orthogonal to each normal."""
    axis = np.where(np.abs(n[0]) < 0.7, np.array([[1], [0], [0]], np.float32), np.array([[0], [1], [0]], np.float32))
    side = axis - dot(n, axis) * n
    return side / np.sqrt(dot(side, side))
