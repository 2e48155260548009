"""What a shader is told of the light and of a material, as arrays and numbers that any program can upload."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..render.environment import DAYLIGHT, Environment
from ..render.lobes import charlie_table, ggx_table
from ..render.material_effects import TURN, ShadingTable
from ..scene.effects import BY_NAME as EFFECT_BY_NAME

LARGEST_FLOAT = float(np.finfo(np.float32).max)


def light_tables(environment: Environment = DAYLIGHT) -> dict[str, Any]:
    """What shading reads of an environment and of the lobes.

    prefiltered: float32 [65, 33, 3], the sky by height and roughness; ggx: float32 [48, 32, 2] and charlie: float32 [48, 32], by
    the root of the view's cosine and roughness; powers, diffuse_powers: float32 [9, 3], coefficients of the sky's radiance, and
    of its irradiance over pi, in powers of the height; lights: dicts of direction [3], irradiance [3] and radius; exposure.
    """
    lights = [{"direction": [float(x) for x in light.direction], "irradiance": [float(x) for x in light.irradiance],
               "radius": float(light.radius)} for light in environment.lights]
    return {"prefiltered": environment.prefiltered_table, "ggx": ggx_table(), "charlie": charlie_table()[..., 0],
            "powers": environment.powers, "diffuse_powers": environment.diffuse_powers, "lights": lights,
            "exposure": float(environment.exposure)}


def material_look(table: ShadingTable, number: int) -> dict[str, Any]:
    """What a shader has to know of material `number` of a table.

    effects: sorted names of those that it uses; parameters: name -> numbers, all that these read; maps: sorted names of the
    channels that these read and that the material has a map of. The numbers are finite, as JSON asks: a distance without end is
    the largest of binary32. A rotation is between -pi and pi, because a GPU's cosine is good near 0 alone.
    """
    effects = sorted(table.effects[number])
    names = sorted({name for effect in effects for name in EFFECT_BY_NAME[effect].parameters})
    parameters = {name: [min(float(v), LARGEST_FLOAT) for v in table.values[name][number]] for name in names}
    if TURN in parameters:
        parameters[TURN] = [math.remainder(parameters[TURN][0], math.tau)]
    return {"effects": effects, "parameters": parameters, "maps": sorted(table.wanted_channels([number]))}
