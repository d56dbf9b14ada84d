"""Models of thesis chapter 4, their runs on all records, and figures of merit."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.signal

import jaxnarx as jnx
from jaxnarx.linear import LinearModel, OrderSearch, innovations
from jaxnarx.metrics import scores
from jaxnarx.regressors import Pool

PARTS = ("identification", "validation", "unseen")
MODES = ("one_step", "free_run")
START = 20
"""First sample that is scored, behind the longest window of any model."""
ORDERS = (6, 6, 6)
"""n_a, n_b, n_k of (4.46)."""
CRITERIA = ("aic", "mdl")
REFINED = ", refined"
SQUARES, DUTY = "NARX, speed squared", "NARX, both squared"
STRUCTURE = "ARX(6, 6, 6)"


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A fitted model, and its speed [rpm] on every record of the data.

    `value` is a `LinearModel` or a `Network`; `diverged` is whether a free run was held
    at its bounds too often.
    """

    value: LinearModel | jnx.Network
    parameters: int
    status: str
    predicted: dict[str, list[np.ndarray]]
    diverged: bool


def linear_methods(chosen: jnx.linear.ARX) -> dict[str, Any]:
    """ARX as chosen and as in the thesis; the others of order two, with its delay."""
    nk = ORDERS[2]
    return {
        "ARX by MDL": chosen,
        STRUCTURE: jnx.linear.ARX(*ORDERS),
        "ARMAX(2, 2, 2, 6)": jnx.linear.ARMAX(2, 2, 2, nk),
        "output error(2, 2, 6)": jnx.linear.OutputError(2, 2, nk),
        "Box-Jenkins(2, 2, 2, 2, 6)": jnx.linear.BoxJenkins(2, 2, 2, 2, nk),
    }


def linear_pool(channels: jnx.Channels, na: int, nb: Any, nk: Any) -> Pool:
    """Terms of an ARX model, the constant first."""
    ahead, back = range(nk, nk + nb), range(1, na + 1)
    return jnx.polynomial_pool(channels, input_lags=ahead, output_lags=back, degree=1)


def narx_pool(channels: jnx.Channels, *, duty: bool = False) -> Pool:
    """Terms of (4.48): those of (4.46), a constant, and squares of the lagged speeds.

    With `duty` also the squares of the lagged duties.
    """
    na, nb, nk = ORDERS
    ahead, back = range(nk, nk + nb), range(1, na + 1)
    every = jnx.polynomial_pool(channels, input_lags=ahead, output_lags=back, degree=2)
    low, high = every.factor.T
    kept = (low == 0) | ((low == high) & ((low > nb) | duty))
    return dataclasses.replace(every, factor=every.factor[kept])


def fitted(data: jnx.Dataset, method: Any) -> Model:
    """A linear model of the first record."""
    found = jnx.linear.fit_linear(data[:1], method)
    model, errors = found.value, innovations(found.value, data)
    free = jnx.simulate(model.network(), data).value
    runs = {"one_step": list(errors.predicted), "free_run": _speeds(free)}
    return Model(model, model.structure.size, found.status_name, runs, _diverged(free))


def networks(data: jnx.Dataset, pool: Pool, refinement: Any) -> list[Model]:
    """Least squares on the first record, then refined with the second as validation."""
    start = jnx.grow(pool, data[:1], jnx.Global())
    after = jnx.refine(start.value, data[:1], refinement, validation=data[1:2])
    return [_network(data, pool, found) for found in (start, after)]


def _network(data: jnx.Dataset, pool: Pool, found: Any) -> Model:
    free = jnx.simulate(found.value, data).value
    runs = {
        "one_step": _speeds(jnx.predict(found.value, data).value),
        "free_run": _speeds(free),
    }
    return Model(found.value, len(pool), found.status_name, runs, _diverged(free))


def _speeds(run: Any) -> list[np.ndarray]:
    return [np.asarray(o)[:, 0] for o in run.outputs]


def _diverged(run: Any) -> bool:
    return bool(np.any(run.diverged))


def pools(channels: jnx.Channels) -> dict[str, Pool]:
    """Terms of the networks by name."""
    return {
        STRUCTURE: linear_pool(channels, *ORDERS),
        SQUARES: narx_pool(channels),
        DUTY: narx_pool(channels, duty=True),
    }


def models(
    data: jnx.Dataset, chosen: jnx.linear.ARX, refinement: Any, names: Sequence[str]
) -> dict[str, Model]:
    """Every linear model, and the networks of `names`, plain and refined."""
    methods = linear_methods(chosen)
    found = {name: fitted(data, method) for name, method in methods.items()}
    for name in names:
        pool = pools(data.channels)[name]
        plain, refined = networks(data, pool, refinement)
        found.setdefault(name, plain)
        found[name + REFINED] = refined
    return found


# figures of merit -----------------------------------------------------------------


def residual(data: jnx.Dataset, model: Model, part: str, mode: str) -> np.ndarray:
    """Measured less predicted speed [rpm] from `START` on."""
    place = PARTS.index(part)
    return (data.records[place].y[:, 0] - model.predicted[mode][place])[START:]


def merit(y: np.ndarray, predicted: np.ndarray) -> dict[str, float]:
    """Fit ratio (4.43) [%], R2 (4.44) [%] and root mean square error [rpm]."""
    columns = y[START:, None], predicted[START:, None]
    found = scores(*columns, np.ones(columns[0].shape, bool))
    values = {
        "fit": found["fit"][0],
        "r2": 100 * found["r2"][0],
        "rmse": found["rmse"][0],
    }
    return {name: float(f"{value:.6g}") for name, value in values.items()}


def judged(data: jnx.Dataset, model: Model) -> dict[str, Any]:
    """Parameters, status, and figures of merit by record and mode."""
    return {
        "parameters": model.parameters,
        "status": model.status,
        "diverged": model.diverged,
        **{
            part: {
                mode: merit(data.records[n].y[:, 0], model.predicted[mode][n])
                for mode in MODES
            }
            for n, part in enumerate(PARTS)
        },
    }


# orders ---------------------------------------------------------------------------


def filtered(model: LinearModel, record: Any) -> np.ndarray:
    """The free run of an ARX model by a filter that starts at the measured past."""
    p = model.polynomials
    a = np.asarray(p.a)
    b = np.r_[np.zeros(model.delays[0]), np.asarray(p.b[0])]
    level = float(p.constant) / a.sum()
    past = max(len(a), len(b)) - 1
    u, y = record.u[:, 0], record.y[:, 0]
    state = scipy.signal.lfiltic(b, a, y[:past][::-1] - level, u[:past][::-1])
    ahead = scipy.signal.lfilter(b, a, u[past:], zi=state)[0]
    return np.r_[y[:past], ahead + level]


def order_rows(search: OrderSearch, data: jnx.Dataset) -> list[dict[str, Any]]:
    """The best one-step structure of every size, and its free run on validation."""
    rows = []
    for place, row in zip(search.frontier.tolist(), search.table, strict=True):
        model = jnx.linear.fit_linear(data[:1], search.method(place)).value
        validation = data.records[1]
        run = filtered(model, validation)
        rows.append(
            {
                "parameters": row["parameters"],
                "orders": list(row["orders"]),
                "unexplained_percent": row["unexplained"],
                "free_run_fit": merit(validation.y[:, 0], run)["fit"],
                "stable": model.stable,
            }
        )
    return rows


def thesis_place(search: OrderSearch) -> int | None:
    """Where the search has the structure of (4.46); None where it has not."""
    own = np.stack([search.na, search.nb[:, 0], search.nk[:, 0]], axis=1)
    places = np.flatnonzero(np.all(own == ORDERS, axis=1))
    return int(places[0]) if len(places) else None


def order_figures(search: OrderSearch, data: jnx.Dataset) -> dict[str, Any]:
    """What AIC and MDL choose, the thesis's structure among them, and the rows."""
    thesis, best = thesis_place(search), search.best_place("mdl")
    left = search.unexplained
    return {
        "structures": len(search),
        "samples": search.samples,
        **{name: list(search.orders(search.best_place(name))) for name in CRITERIA},
        "thesis": list(ORDERS),
        "thesis_unexplained_percent": None if thesis is None else float(left[thesis]),
        "mdl_unexplained_percent": float(left[best]),
        "sizes": order_rows(search, data),
    }
