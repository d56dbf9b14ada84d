"""What every partition starts from: rows, terms, and scaled scheduling variables."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError
from jaxnarx.methods import ForwardOLS, StepwiseF
from jaxnarx.models import AbstractValidity, OutputModel, local_models, output_model
from jaxnarx.partition.scaffold import scheduling_table
from jaxnarx.regressors import Pool, Variables, row_columns, variable_names
from jaxnarx.regressors.rows import Rows, regression_rows


@dataclasses.dataclass(frozen=True, eq=False)
class Ground:
    """Rows of the data with the candidate terms of every output.

    `z` are the scheduling variables of every row, scaled to [0, 1]; x = offset + span z
    in physical units.
    """

    pool: Pool
    factors: list[Int[np.ndarray, "_ degree"]]
    data: Dataset
    rows: Rows
    scheduling: Variables
    offset: Float[np.ndarray, " dims"]
    span: Float[np.ndarray, " dims"]
    z: Float[Array, "dims rows"]

    @property
    def names(self) -> list[str]:
        """Texts of the scheduling variables."""
        return variable_names(self.pool.channels, self.scheduling)

    def samples(self, output: int) -> float:
        """Rows that count for an output."""
        return float(np.sum(np.asarray(self.rows.weight[output]) > 0))

    def model(
        self,
        output: int,
        theta: Float[Array | np.ndarray, "models terms"],
        validity: AbstractValidity,
        count: int,
        *,
        sparse: bool = False,
    ) -> OutputModel:
        """One output's model; slots from `count` on are inactive.

        With `sparse` every local model has the terms whose coefficient is not zero.
        """
        local = local_models(self.factors[output], theta, sparse=sparse)
        active = jnp.arange(len(theta)) < count
        return output_model(
            local, validity, self.scheduling, self.offset, self.span, active
        )


def make_ground(
    pool: Pool,
    factors: list[Int[np.ndarray, "_ degree"]],
    data: Dataset,
    scheduling: tuple[str, ...],
    gain: Float[np.ndarray, " signals"] | None,
    local: ForwardOLS | StepwiseF | None = None,
) -> Ground:
    """Rows and ranges; `DataError` where there are too few or nothing moves."""
    table = scheduling_table(pool, scheduling) if scheduling else Variables(())
    terms = max(len(f) for f in factors)
    if local is not None:
        terms = min(local.max_terms, terms)
    rows = regression_rows(
        data,
        pool.variables,
        pool.outputs,
        history=max(pool.variables.longest, table.longest),
        need=terms + 1,
        gain=gain,
    )
    x = row_columns(rows.batch, rows.at, table, data.sample_time)
    low, span = _ranges(pool, x, table)
    z = (jnp.asarray(x) - low[:, None]) / span[:, None]
    return Ground(pool, factors, data, rows, table, low, span, z)


def _ranges(pool: Pool, x: np.ndarray, table: Variables):
    """Lower end and width of every scheduling variable's range."""
    if not len(table):
        return np.zeros(0, x.dtype), np.zeros(0, x.dtype)
    low, high = x.min(axis=1), x.max(axis=1)
    # a filter leaves rounding errors on a constant
    least = 100 * np.finfo(x.dtype).eps * np.maximum(np.abs(low), np.abs(high))
    constant = ~(high - low > least)
    names = variable_names(pool.channels, table)
    for s, name, a, flat in zip(table.signal, names, low, constant, strict=True):
        if flat:
            raise DataError(
                f"scheduling variable {name} is constant ({a:g}); choose one that "
                "moves",
                channel=pool.channels.names[s],
            )
    return low, high - low
