"""Networks that a network might as well have been, by leaving groups of records out.

With theta of all n groups and theta_g without one of them, (n - 1) / n times the sum of
squares of theta_g - mean estimates the covariance of theta, whatever the residuals look
like: of records it holds the error of the structure as well as the noise. The networks
here have coefficients theta + sqrt(n - 1) (theta_g - theta), so that their spread is
about that.

M. H. Quenouille, "Notes on bias in estimation", Biometrika 43 (1956) 353-360;
J. W. Tukey, "Bias and confidence in not quite large samples", Annals of Mathematical
Statistics 29 (1958) 614.
"""

import dataclasses
import math

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import Progress
from jaxnarx.checks import whole
from jaxnarx.data import Dataset, Groups
from jaxnarx.data import groups as find_groups
from jaxnarx.errors import DataError
from jaxnarx.models import Network, OutputModel
from jaxnarx.refinement import refine
from jaxnarx.settings import SimulationError
from jaxnarx.simulation import simulate
from jaxnarx.solution import RESULTS, Solution

FEWEST_GROUPS = 2
MOST_STEPS = 5
"""Steps of every training: coefficients alone move, and little."""
HALVINGS = 4
"""Times that a network whose runs diverge is brought nearer to the given one."""


@guard_arguments
def jackknife(
    network: Network,
    data: Dataset,
    *,
    groups: Groups | None = None,
    max_steps: int = MOST_STEPS,
    progress: Progress | None = None,
) -> Solution[list[Network]]:
    """One network for every group of records, as if that group had counted otherwise.

    Coefficients are trained once more without the group, on the free run, and moved
    away by sqrt(groups - 1) times the difference: the networks scatter as the network
    itself would from one set of records to another. Regions, terms and ranges stay.
    `jaxnarx.calibration.optimise` takes them together with `network`, and asks limits
    of all.

    Args:
        network: A network that was trained on these records.
        data: The records.
        groups: What is left out together; by default `jaxnarx.data.groups(data)`.
        max_steps: Steps of every training.
        progress: A function called with a dictionary before every group is left out:
            its number `group`, from 1, and how many there are, `of`.

    Returns:
        `value` has one network for every group, of the structure of the given one;
        `stats["shares"]` the share of its move that each has made: less than one where
        more would diverge. Status `ok`; where even a sixteenth diverges `diverged`, and
        where a training fails its status: that network stays as it was given, with a
        share of zero, and `detail` names the group.

    Raises:
        DataError: there is one group alone, or what is left cannot be trained on.

    Example:
        engines = [network, *jnx.confidence.jackknife(network, data).value]
        print(len(engines))
    """
    whole(max_steps, "max_steps", 1)
    groups = find_groups(data) if groups is None else groups
    count = len(groups)
    if count < FEWEST_GROUPS:
        raise DataError("of one group of records none can be left out")
    rules = SimulationError(train="coefficients", horizons=(), max_steps=max_steps)
    found, shares = [], []
    status, detail = RESULTS.ok, ""
    for g, fold in enumerate(groups.folds(data)):
        if progress is not None:
            progress({"group": g + 1, "of": count})
        fit, near, share = refine(network, fold.train, rules), network, 0.0
        if fit.is_okay:
            near, share = _move(network, fit.value, math.sqrt(count - 1), data)
        if not share:
            status = RESULTS.diverged if fit.is_okay else fit.status
            told = "runs diverge" if fit.is_okay else "the training fails"
            detail = f"{told} without {groups.names[g]}"
        found.append(near)
        shares.append(share)
    return Solution(found, status, {"shares": shares}, detail)


def _move(
    network: Network, other: Network, factor: float, data: Dataset
) -> tuple[Network, float]:
    """The network moved towards another one and beyond, as far as its runs stay."""
    share = 1.0
    for _ in range(HALVINGS + 1):
        pairs = zip(network.models, other.models, strict=True)
        models = tuple(_beyond(mine, theirs, share * factor) for mine, theirs in pairs)
        moved = dataclasses.replace(network, models=models)
        if simulate(moved, data).is_okay:
            return moved, share
        share /= 2
    return network, 0.0


def _beyond(mine: OutputModel, theirs: OutputModel, factor: float) -> OutputModel:
    """Coefficients at so many times the way from one to the other."""
    start, end = mine.local.coefficient, theirs.local.coefficient
    local = dataclasses.replace(mine.local, coefficient=start + factor * (end - start))
    return dataclasses.replace(mine, local=local)
