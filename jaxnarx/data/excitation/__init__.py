"""Excitation signals: what to feed an engine so that its records tell something.

Every signal takes `key` first if it is random, then its length in samples, and returns
one input over time; several inputs are stacked with `jnp.stack(..., axis=-1)`, or
planned together with `aprbs_plan`. Not imported by `jaxnarx.data`, because this loads
jax.
"""

from jaxnarx.data.excitation.aprbs import aprbs
from jaxnarx.data.excitation.assess import Assessment, assess, visited
from jaxnarx.data.excitation.chirp import chirp
from jaxnarx.data.excitation.coverage import Coverage, cells, coverage
from jaxnarx.data.excitation.driving_cycle import driving_cycle
from jaxnarx.data.excitation.holds import hold_times
from jaxnarx.data.excitation.limits import limited
from jaxnarx.data.excitation.multisine import crest_factor, multisine
from jaxnarx.data.excitation.placement import discrepancy, latin_hypercube, sobol
from jaxnarx.data.excitation.plan import (
    AprbsPlan,
    check_plan,
    feasible,
    reachable,
    render,
)
from jaxnarx.data.excitation.prbs import prbs
from jaxnarx.data.excitation.random_plan import aprbs_plan
from jaxnarx.data.excitation.random_walk import random_walk
from jaxnarx.data.excitation.spectrum import Spectrum, bandwidth, spectrum
from jaxnarx.data.excitation.steps import ramps, steps

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
