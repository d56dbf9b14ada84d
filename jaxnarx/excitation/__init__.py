"""Excitation signals: what to feed an engine so that its records tell something.

Every signal takes `key` first if it is random, then its length in samples, and returns
one input over time; several inputs are stacked with `jnp.stack(..., axis=-1)`, or
planned together with `aprbs_plan`. Not imported by `jaxnarx.data`, because this loads
jax.
"""

from jaxnarx.excitation.assess import (
    Assessment,
    Coverage,
    Spectrum,
    assess,
    bandwidth,
    cells,
    coverage,
    spectrum,
    visited,
)
from jaxnarx.excitation.courses import driving_cycle, limited, ramps, steps
from jaxnarx.excitation.placement import discrepancy, latin_hypercube, sobol
from jaxnarx.excitation.plan import (
    AprbsPlan,
    aprbs_plan,
    check_plan,
    feasible,
    reachable,
    render,
)
from jaxnarx.excitation.sines import chirp, crest_factor, multisine
from jaxnarx.excitation.staircases import aprbs, hold_times, prbs, random_walk

__all__ = [
    "AprbsPlan",
    "Assessment",
    "Coverage",
    "Spectrum",
    "aprbs",
    "aprbs_plan",
    "assess",
    "bandwidth",
    "cells",
    "check_plan",
    "chirp",
    "coverage",
    "crest_factor",
    "discrepancy",
    "driving_cycle",
    "feasible",
    "hold_times",
    "latin_hypercube",
    "limited",
    "multisine",
    "prbs",
    "ramps",
    "random_walk",
    "reachable",
    "render",
    "sobol",
    "spectrum",
    "steps",
    "visited",
]
