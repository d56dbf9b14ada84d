"""The settings of a whole identification: one tree for verb, command line and sweep."""

import dataclasses
from typing import Any

from jaxnarx.settings.anova import Anova
from jaxnarx.settings.partition import (
    Given,
    Global,
    Grid,
    Lolimot,
    Placed,
    SigmoidTree,
)
from jaxnarx.settings.pool import Polynomial
from jaxnarx.settings.protocols import Selector
from jaxnarx.settings.refinement import PredictionError, SimulationError
from jaxnarx.settings.selection import Backward, ForwardOLS, StepwiseF
from jaxnarx.settings.simulation_ols import SimulationOLS


@dataclasses.dataclass(frozen=True)
class Identification:
    """Candidate terms, selection, partition and refinement, in this order.

    A setting is named by its path, such as `"grow.max_models"`: in a sweep's cases, in
    files, and by `jaxnarx identify --set`.

    Example:
        method = jnx.Identification(
            pool=jnx.Polynomial(input_lags=(0, 1), output_lags=(1,)),
            select=jnx.ForwardOLS(max_terms=6),
        )
        print(method.grow)
    """

    _: dataclasses.KW_ONLY
    pool: Polynomial | Any = Polynomial()
    """The candidate terms; a `Pool` of one's own, too."""
    select: ForwardOLS | StepwiseF | Backward | SimulationOLS | Anova | Selector = (
        ForwardOLS(max_terms=25)
    )
    """How terms are chosen: forward by error reduction ratio; stepwise by partial F;
    forward, then backward by partial F; by what they bring to the free run; or by
    analysis of variance. In Python also a function of one's own."""
    grow: Global | Lolimot | SigmoidTree | Grid | Placed | Given = Global()
    """How the operating space is divided: not at all; boxes with Gaussians; a tree of
    sigmoids with oblique borders, or with borders across one variable each
    (axis-tree); as it is told; or at samples or clusters. In Python also a partition
    from elsewhere."""
    refine: SimulationError | PredictionError | None = SimulationError()
    """Method of refinement: it lowers the error of the free run or that of one step; or
    no refinement."""
