"""Settings of the verbs: frozen and jax-free, so that the command line can use them."""

from jaxnarx.methods.anova import Anova
from jaxnarx.methods.design import OptimalDesign
from jaxnarx.methods.partition import Global, Grid, Lolimot, SigmoidTree
from jaxnarx.methods.refinement import PredictionError, SimulationError
from jaxnarx.methods.selection import Backward, ForwardOLS, StepwiseF
from jaxnarx.methods.simulation_ols import SimulationOLS

__all__ = [
    "Anova",
    "Backward",
    "ForwardOLS",
    "Global",
    "Grid",
    "Lolimot",
    "OptimalDesign",
    "PredictionError",
    "SigmoidTree",
    "SimulationError",
    "SimulationOLS",
    "StepwiseF",
]
