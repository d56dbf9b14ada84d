"""The start of every partition: rows, terms, and scaled scheduling variables."""

import dataclasses
import functools

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError
from jaxnarx.models import AbstractValidity, OutputModel, local_models, output_model
from jaxnarx.partition.scaffold import scheduling_table
from jaxnarx.regressors import (
    Centring,
    Pool,
    Rows,
    Variables,
    evaluate,
    regression_rows,
    row_columns,
    variable_names,
)
from jaxnarx.settings import ForwardOLS, StepwiseF


@dataclasses.dataclass(frozen=True, eq=False)
class TrainingRows:
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

    @functools.cached_property
    def centre(self) -> Centring | None:
        """Offsets of what is far from zero."""
        return self.rows.find_centring(self.pool.variables)

    def constant(self, output: int) -> int | None:
        """Place of the constant among an output's candidates, if it is one."""
        rows = np.flatnonzero(~self.factors[output].any(axis=1))
        return int(rows[0]) if rows.size else None

    def columns(
        self, output: int
    ) -> tuple[Float[Array, "terms rows"], Float[Array, " rows"]]:
        """Columns to fit an output with, and what to fit.

        Columns of its terms, or, where channels are far from zero, columns of the same
        span without their offsets; `coefficients` gives those of the terms.
        """
        factor = self.factors[output]
        if self.centre is None:
            return _columns(factor, self.rows.v, self.rows.y, output)
        y = self.rows.y[output]
        if self.constant(output) is not None:
            y = y - float(self.centre.target[output])
        return self.centre.columns(factor, self.rows.v)[0], y

    def coefficients(
        self, output: int, psi: Float[Array | np.ndarray, "*models terms"]
    ) -> Float[np.ndarray, "*models terms"]:
        """Coefficients of an output's terms from those of its `columns`."""
        psi = np.asarray(psi)
        if self.centre is None:
            return psi
        theta = psi @ self.centre.reduce(self.factors[output])[0].astype(psi.dtype)
        if (at := self.constant(output)) is not None:
            theta[..., at] += self.centre.target[output]
        return theta

    def warning(self, models: list[OutputModel]) -> str:
        """The warning where rounding spoils an output, or nothing."""
        for o, model in enumerate(models if self.centre is not None else []):
            assert self.centre is not None
            local, y = model.local, np.asarray(self.rows.y[o])
            size = float(np.std(y[np.asarray(self.rows.weight[o]) > 0]))
            dense = np.asarray(local.dense())[np.asarray(model.active)]
            named = self.pool.channels, self.pool.variables
            told = self.centre.warning(np.asarray(local.factor), dense, size, *named)
            if told:
                place = self.pool.outputs[o]
                return f"{self.pool.channels.output_names[place]}: {told}"
        return ""

    @property
    def names(self) -> list[str]:
        """Texts of the scheduling variables."""
        return variable_names(self.pool.channels, self.scheduling)

    def weight(self, output: int) -> Float[Array, " rows"]:
        """Weights of the rows for an output."""
        return jax.device_put(np.asarray(self.rows.weight)[output])

    def samples(self, output: int) -> float:
        """Rows that count for an output."""
        return float(np.sum(np.asarray(self.rows.weight)[output] > 0))

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
        active = np.arange(len(theta)) < count
        return output_model(
            local, validity, self.scheduling, self.offset, self.span, active
        )


@jax.jit
def _columns(factor, v, y, output):
    return evaluate(factor, v), y[output]


def make_training_rows(
    pool: Pool,
    factors: list[Int[np.ndarray, "_ degree"]],
    data: Dataset,
    scheduling: tuple[str, ...],
    gain: Float[np.ndarray, " signals"] | None,
    local: ForwardOLS | StepwiseF | None = None,
) -> TrainingRows:
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
    low, span = scheduling_ranges(pool, x, table)
    z = jax.device_put((x - low[:, None]) / span[:, None])
    return TrainingRows(pool, factors, data, rows, table, low, span, z)


def scheduling_ranges(
    pool: Pool, x: Float[np.ndarray, "dims rows"], table: Variables
) -> tuple[Float[np.ndarray, " dims"], Float[np.ndarray, " dims"]]:
    """Lower end and width of every scheduling variable's range; `DataError` where one
    does not move."""
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
