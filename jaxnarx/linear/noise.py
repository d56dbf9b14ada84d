"""The nonlinear Box-Jenkins model: a network's free run, and coloured noise on it.

    y(t) = y_u(t) + C(q)/D(q) e(t)

with y_u the free run of the network, the nonlinear plant that knows nothing of e, and
C/D as in (2.3). It is the class NBJ of thesis section 2.1.4, whose simulated output has
zeros in place of e and e_u: e_u(t) = y(t) - y_u(t) is what the noise model filters, and

    y(t | t - 1) = y_u(t) + e_u(t) - e(t) ,    e = D/C e_u

is the best one-step prediction if e is white. The plant stays as it is: identify it for
its free run (`refine`), then the noise.
"""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.linear._innovations import Innovations, innovations
from jaxnarx.linear.fit import fit_linear
from jaxnarx.linear.model import LinearModel
from jaxnarx.models import Network
from jaxnarx.settings import BoxJenkins
from jaxnarx.simulation import match_records, simulate
from jaxnarx.solution import Solution


class NoiseModel(eqx.Module):
    """A network and, for one of its outputs, the linear model of its free-run error."""

    network: Network
    noise: LinearModel

    def predict(self, data: Dataset) -> Innovations:
        """One-step predictions and their errors e, in the output's unit.

        True where the free run counts and the measurement is valid. `simulate` of the
        network is the free run of the whole: its best prediction without measurements.
        """
        errors = _errors(self.network, data)
        found = innovations(self.noise, errors)
        o = self.noise.output
        y = [record.y[:, o] for record in match_records(self.network, data)]
        predicted = (a - e for a, e in zip(y, found.error, strict=True))
        return dataclasses.replace(found, predicted=tuple(predicted))


@guard_arguments
def fit_noise(
    network: Network,
    data: Dataset,
    *,
    nc: int = 1,
    nd: int = 1,
    output: str | None = None,
) -> Solution[NoiseModel]:
    """Fit C and D, of the orders `nc` and `nd`, to the free-run error of one output.

    It minimises the prediction error, as `fit_linear` does; a constant takes up the
    mean error. Stats and statuses are those of `fit_linear`. `value.noise` has the
    polynomials, poles and standard errors, `value.predict(data)` the predictions.
    """
    errors = _errors(network, data)
    name = output or network.output_names[0]
    found = fit_linear(errors, BoxJenkins(nb={}, nf={}, nc=nc, nd=nd), output=name)
    value = NoiseModel(network, found.value)
    return Solution(value, found.status, found.stats, found.detail)


def _errors(network: Network, data: Dataset) -> Dataset:
    """The records with the free run's errors as outputs, valid where they are scored.

    Outputs that the network does not model are not valid anywhere.
    """
    data = match_records(network, data)
    run = simulate(network, data).value
    inputs, modelled = len(data.channels.inputs), list(network.modelled)
    records = []
    for record, y, scored in zip(data, run.outputs, run.scored, strict=True):
        known = np.zeros_like(record.y, bool)
        known[:, modelled] = scored
        error: Float[np.ndarray, "time outputs"] = np.zeros_like(record.y)
        error[:, modelled] = np.where(scored, record.y[:, modelled] - y, 0.0)
        valid = np.concatenate([record.valid[:, :inputs], known], axis=1)
        records.append(dataclasses.replace(record, y=error, valid=valid))
    return dataclasses.replace(data, records=tuple(records))
