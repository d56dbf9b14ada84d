"""Cases as arrays: what a sweep varies without compiling anew."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.errors import SpecError, suggest
from jaxnarx.methods import Case, Identification
from jaxnarx.regressors import Pool

Arrays = np.ndarray | Array


class Settings(eqx.Module):
    """A `Case` for the program; `variables` tells which lagged variables it may use."""

    terms: Int[Arrays, "*lanes"]
    models: Int[Arrays, "*lanes"]
    steps: Int[Arrays, "*lanes"]
    seed: Int[Arrays, "*lanes"]
    variables: Bool[Arrays, "*lanes vars"]
    coefficients: Bool[Arrays, "*lanes"]
    partition: Bool[Arrays, "*lanes"]
    staged: Bool[Arrays, "*lanes"]
    k_sigma: Float[Arrays, "*lanes"]
    smoothness: Float[Arrays, "*lanes"]
    ridge: Float[Arrays, "*lanes"]
    growth_ridge: Float[Arrays, "*lanes"]
    rho: Float[Arrays, "*lanes"]
    scatter: Float[Arrays, "*lanes"]


NUMBERS = ("k_sigma", "smoothness", "ridge", "growth_ridge", "rho", "scatter")


def make_settings(
    case: Case, method: Identification, pool: Pool, dtype: np.dtype
) -> Settings:
    """The arrays of a case; `SpecError` where it exceeds a capacity."""
    case = within(case, method)
    return Settings(
        terms=np.asarray(case.terms),
        models=np.asarray(case.models),
        steps=np.asarray(case.steps),
        seed=np.asarray(case.seed),
        variables=allowed_variables(case, pool),
        coefficients=np.asarray(case.train in ("joint", "staged", "coefficients")),
        partition=np.asarray(case.train in ("joint", "staged", "partition")),
        staged=np.asarray(case.train == "staged"),
        **{name: np.asarray(getattr(case, name), dtype) for name in NUMBERS},
    )


def within(case: Case, method: Identification) -> Case:
    """The case with numbers in place of None, none beyond its capacity."""
    most = {
        "terms": method.max_terms,
        "models": method.max_models,
        "steps": method.steps,
    }
    for field, limit in most.items():
        value = getattr(case, field)
        if value is not None and value > limit:
            raise SpecError(
                f"a case asks for {value} {field}, the identification has room for "
                f"{limit}; raise {'steps' if field == 'steps' else 'max_' + field}",
                field=field,
            )
    given = {f: getattr(case, f) for f in most}
    chosen = {f: most[f] if v is None else v for f, v in given.items()}
    return dataclasses.replace(case, **chosen)


def allowed_variables(case: Case, pool: Pool) -> Bool[np.ndarray, " vars"]:
    """Which lagged variables a case may use; the first entry is that of "times one"."""
    signals, lags = pool.variables.signal, pool.variables.lag
    limit = np.full(len(pool.channels.all), np.iinfo(np.int64).max)
    if isinstance(case.lags, int):
        limit[:] = case.lags
    elif case.lags is not None:
        for name, lag in dict(case.lags).items():
            if name not in pool.channels.names:
                raise SpecError(
                    f"lags names {name!r}. {suggest(name, pool.channels.names)}",
                    field="lags",
                )
            limit[pool.channels.signal(name)] = lag
    return np.concatenate([[True], lags <= limit[signals]])
