"""Batches of a 3DNTC fit and the latents around samples, computed on the GPU: as fit_samples.order_along_curve and cells_of, in a
tenth of a second instead of ten."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...field.morton import spread
from .fit_samples import _corner_rows
from .infer import LOCAL_BITS, POSITION_BITS

CURVE = 2048  # cells a side of order_along_curve
CELL_BITS = 14  # of a cell's coordinate: resolutions go to 2**13


def _cell_coordinates(position, resolution):
    """Cells of latents that points lie in, int64 [M, 3], from 0. position: tensor int32 [M, 3]."""
    local = ((position.long() * resolution) >> (POSITION_BITS - LOCAL_BITS)) - (1 << (LOCAL_BITS - 1))
    return (local >> LOCAL_BITS) + 1


def order_on(position: Any) -> Any:
    """Return order_along_curve() on a device: from a tensor int32 [M, 3] of positions to a tensor int64 [M]."""
    import torch

    x, y, z = _cell_coordinates(position, CURVE).unbind(1)
    return torch.sort(spread(x) | spread(y) << 1 | spread(z) << 2, stable=True).indices


def cells_on(position: Any, field: Any, tables: list) -> tuple[Any, Any]:
    """Return cells_of() on a device, with another order of cells: tensors (cell int32 [M, L], corners int32 [cells, 8]).
    position: tensor int32 [M, 3]; field: tensor int16 [M]; tables: payload.Tables by field."""
    import torch

    device, levels, num_cells, corners = position.device, len(tables[0].index[0]), 0, []
    cell = torch.empty((len(position), levels), dtype=torch.int32, device=device)
    for number, table in enumerate(tables):
        of_field = torch.nonzero(field == number).reshape(-1)
        of_level, places, slots, bricks, words, ranks = table.index
        for n in range(levels):
            x, y, z = _cell_coordinates(position[of_field], int(of_level[n, 0])).unbind(1)
            keys, inverse = torch.unique(x | y << CELL_BITS | z << (2 * CELL_BITS), return_inverse=True)
            first = torch.empty(len(keys), dtype=torch.int64, device=device)
            first[inverse] = of_field
            rows = np.empty((len(keys), 8), np.int32)
            s, t, b, e = places[n, 0], places[n + 1, 0], places[n, 1], places[n + 1, 1]
            where = np.ascontiguousarray(position[first].cpu().numpy())
            _corner_rows(where, *of_level[n], slots[s:t], bricks[b:e], words[b:e], ranks[b:e], rows)
            cell[of_field, n] = (num_cells + inverse).int()
            corners.append(torch.as_tensor(rows, device=device))
            num_cells += len(rows)
    return cell, torch.cat(corners) if corners else torch.empty((0, 8), dtype=torch.int32, device=device)
