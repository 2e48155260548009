"""Syntax of the attribute unit that holds a 3DNTC payload (spec clauses 5.7.4 and 5.7.5)."""

from ...core.syntax_table import Derived, Structure
from ...core.syntax_table import Element as E
from .parameter_count import WAVE_INPUTS, parameter_count

FORM_RESIDENT, FORM_TRANSPORT = range(2)

LATENT_LEVEL = Structure("latent_level", "5.7.5", (
    E("level_resolution", "u16", 1, 8192),
    E("table_log2", "u8", 0, 24),
    E("latent_threshold", "u16"),
    Derived("NumCounts", "table_log2 == 0 ? num_fields : 0", lambda v: 0 if v["table_log2"] else v["num_fields"]),
    E("num_latents", "v", 1, count="NumCounts"),
    Derived("NumRows", "table_log2 == 0 ? sum of num_latents : 2^table_log2",
            lambda v: 1 << v["table_log2"] if v["table_log2"] else sum(v["num_latents"])),
), least=5)


def _network_widths(values):
    inputs = values["num_levels"] * values["num_features"] + WAVE_INPUTS * values["wave_octaves"]
    return [inputs, *values["hidden_width"], values["NumOutputs"]]


NEURAL = Structure("neural_parameters", "5.7.4", (
    E("form", "u8", 0, 1, registry=True),
    E("num_features", "u8", 2, 64),
    E("wave_octaves", "u8", 0, 8),
    E("first_wave", "u16", 1, 16384),
    E("num_hidden", "u8", 1, 4),
    E("hidden_width", "u8", 1, 128, count="num_hidden"),
    E("num_levels", "u8", 1, 4),
    E("latent_levels", LATENT_LEVEL, count="num_levels"),
    Derived("Widths", "num_levels * num_features + 6 * wave_octaves, hidden_width[0], hidden_width[1], ..., NumOutputs",
            _network_widths),
    Derived("ParameterBytes", "2 * (sum over i = 0..num_hidden of (Widths[i] + 1) * Widths[i + 1])",
            lambda v: 2 * parameter_count(v["Widths"])),
    E("network_data", "bytes", count="ParameterBytes"),
    E("latent_data", "bytes"),
))
