"""Excitation signals: what to feed an engine so that its records tell something.

Every signal takes `key` first if it is random, then its length in samples, and returns
one input over time; several inputs are stacked with `jnp.stack(..., axis=-1)`, or
planned together with `aprbs_plan`. Not imported by `jaxnarx.data`, because this loads
jax.
"""

from jaxnarx.excitation._assess import Assessment as Assessment
from jaxnarx.excitation._assess import Coverage as Coverage
from jaxnarx.excitation._assess import Spectrum as Spectrum
from jaxnarx.excitation._assess import assess as assess
from jaxnarx.excitation._assess import bandwidth as bandwidth
from jaxnarx.excitation._assess import cells as cells
from jaxnarx.excitation._assess import coverage as coverage
from jaxnarx.excitation._assess import spectrum as spectrum
from jaxnarx.excitation._assess import visited_rows as visited_rows
from jaxnarx.excitation.courses import driving_cycle as driving_cycle
from jaxnarx.excitation.courses import limit_slope as limit_slope
from jaxnarx.excitation.courses import ramps as ramps
from jaxnarx.excitation.courses import random_drive as random_drive
from jaxnarx.excitation.courses import steps as steps
from jaxnarx.excitation.placement import discrepancy as discrepancy
from jaxnarx.excitation.placement import latin_hypercube as latin_hypercube
from jaxnarx.excitation.placement import sobol as sobol
from jaxnarx.excitation.plan import AprbsPlan as AprbsPlan
from jaxnarx.excitation.plan import aprbs_plan as aprbs_plan
from jaxnarx.excitation.plan import check_plan as check_plan
from jaxnarx.excitation.plan import feasible as feasible
from jaxnarx.excitation.plan import reachable as reachable
from jaxnarx.excitation.plan import render as render
from jaxnarx.excitation.sines import chirp as chirp
from jaxnarx.excitation.sines import crest_factor as crest_factor
from jaxnarx.excitation.sines import multisine as multisine
from jaxnarx.excitation.staircases import aprbs as aprbs
from jaxnarx.excitation.staircases import hold_times as hold_times
from jaxnarx.excitation.staircases import prbs as prbs
from jaxnarx.excitation.staircases import random_walk as random_walk
