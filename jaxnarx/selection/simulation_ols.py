"""Selection on simulation error: which term would help the free run most?

Adding term j with a small coefficient changes the run by that coefficient times the
*filtered* column s_j, which obeys s_j(t) = A_t s_j(lags) + p_j(t) with the term's value
p_j at the lags the run has seen (DESIGN section 4). The derivative of the loss by the
new coefficient is <e, s_j>. With the adjoint of the filter it needs no filtering of
candidates: lambda = F' e is one filtered residual, and <e, s_j> = <lambda, p_j> is one
contraction of the whole pool.

The derivative alone favours large columns, so the best candidates by <lambda, p_j>^2 /
|p_j|^2 are filtered in earnest: a network with them at coefficient zero gives the Gram
matrix of all their filtered columns beside those of the chosen terms in one pass of the
refinement's normal equations. Candidate j promises b_j^2 / d_j, after both are freed of
the chosen columns, as in the search on one-step errors.

The thesis's first item of future work; the criterion is that of simulation-based
selection, Piroddi and Spinelli, "An identification algorithm for polynomial NARX
models based on simulation error minimization", Int. J. Control 76 (2003), who refit and
simulate for every candidate.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import Progress, contract, linear_recurrence, positions
from jaxnarx.data import Dataset
from jaxnarx.models import Network, assemble, depth, global_model
from jaxnarx.refinement import (
    Layout,
    linearise_run,
    make_layout,
    make_task,
    normal_equations,
    refine_task,
    seen_history,
)
from jaxnarx.regressors import Centring, Pool
from jaxnarx.settings import SimulationError, SimulationOLS
from jaxnarx.simulation import RunInputs, run
from jaxnarx.solution import RESULTS

WINDOW_HORIZONS = (10, 30, 100, 300)
"""Windows of the first refinement, in samples."""


@eqx.filter_jit
def pool_derivatives(
    network: Network,
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    weight: Float[Array, "records time outputs"],
    factor: Int[Array, "terms degree"] | Int[np.ndarray, "terms degree"],
    position: Int[Array, " terms"] | Int[np.ndarray, " terms"],
    offset: tuple[Float[Array, " vars"], Float[Array, " vars"]] | None = None,
) -> tuple[Float[Array, " terms"], Float[Array, " terms"], Float[Array, ""]]:
    """Half the derivative of the loss by every pool term's coefficient, at zero.

    Also the weighted squared norm of every term along the run, and the loss. One
    output. With `offset`, shift and spread of the variables, those of the centred ones.
    """
    y = run(network, drive, anchor)
    past, own = seen_history(network, y, drive.measured, anchor)
    # A sample without weight may be anything, infinite sensitivities included.
    residual = jnp.where(weight > 0, weight * (y - drive.measured), 0.0)

    def one(v, x, past, own, residual):
        a, limited, v, _ = linearise_run(network, v, x, past, own)
        start = jnp.zeros((depth(network), y.shape[2]), y.dtype)
        _, pull = jax.vjp(lambda d: linear_recurrence(a, d, start)[1], residual)
        return v, jnp.where(limited, 0.0, pull(residual)[0])

    v, adjoint = jax.lax.map(lambda r: one(*r), (drive.v, drive.x, past, own, residual))
    v = jnp.moveaxis(v, 1, 0).reshape(v.shape[1], -1)
    if offset is not None:
        v = (v - offset[0][:, None]) / offset[1][:, None]
    degree = factor.shape[1]
    derivative = contract(v, adjoint.reshape(1, -1), degree)[0, position]
    norm = contract(v, weight.reshape(1, -1), degree, squared=True)[0, position]
    return derivative, norm, jnp.sum(weight * (y - drive.measured) ** 2)


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """The end of the search; `network` holds the refined coefficients."""

    network: Network
    terms: list[int]
    loss: float
    history: list[dict[str, Any]]
    status: RESULTS
    detail: str


class _Rounds:
    """Bookkeeping of the rounds on the host."""

    def __init__(self, pool: Pool, data: Dataset, gain, method, usable, progress):
        self.pool = pool
        self.method: SimulationOLS = method
        self.usable, self.progress = usable.copy(), progress
        self.position = positions(pool.factor, len(pool.variables) + 1)
        self.history: list[dict[str, Any]] = []
        first = global_model(pool.factor[:1], np.zeros(1, gain.dtype))
        self.base = assemble(pool, data, gain, [first])
        self.task, _ = make_task(self.base, data)
        low, high = np.asarray(self.base.low), np.asarray(self.base.high)
        self.centre = Centring.from_ranges(low, high, gain, pool.variables)
        self.offset, self.parents = None, None
        if self.centre is not None:
            pair = self.centre.shift, self.centre.spread
            self.offset = jnp.asarray(pair[0]), jnp.asarray(pair[1])
            self.parents, _ = self.centre.parents(pool.factor, self.usable)
        # One slot to spare: a full model takes a term in before it drops another.
        self.slots = method.max_terms + 1

    def network(self, terms: list[int], theta, slots: int) -> Network:
        """`terms` with coefficients, padded to `slots` so that programs are shared."""
        spare = slots - len(terms)
        factor = self.pool.factor[np.array([*terms, *[0] * spare], int)]
        value = np.r_[theta, np.zeros(spare)].astype(self.base.gain.dtype)
        model = global_model(factor, value)
        used = jnp.asarray(np.arange(slots) < len(terms))[None]
        model = eqx.tree_at(lambda m: m.local.used, model, used)
        return eqx.tree_at(lambda n: n.models, self.base, (model,))

    def refine(self, terms, theta, *, first: bool = False):
        """Coefficients after refinement on the free run, and how it ended."""
        network = self.network(terms, theta, self.slots)
        steps = SimulationError(
            horizons=WINDOW_HORIZONS if first else (),
            max_steps=self.method.steps,
            window_steps=10,
        )
        layout = self.layout(network)
        solution = refine_task(layout, self.task, self.task, steps)
        theta = np.asarray(solution.value.models[0].local.coefficient)[0, : len(terms)]
        return theta, solution

    def layout(self, network: Network) -> Layout:
        """All coefficients, those of columns without offsets."""
        return make_layout(network, None, (0.5, 2.0), centred=True)

    def admissible_terms(self, terms: list[int]) -> Bool[np.ndarray, " terms"]:
        """Terms whose parts are in the model, see `Centring.parents`."""
        there = np.zeros(len(self.pool) + 1, bool)
        there[[*terms, -1]] = True
        if self.parents is None:
            return np.ones(len(self.pool), bool)
        return np.all(there[self.parents], axis=1)

    def remove_term(self, terms: list[int], theta, place: int):
        """Terms and coefficients without one of them, its column's share taken off."""
        fewer = [t for n, t in enumerate(terms) if n != place]
        if self.centre is not None:
            back = self.centre.reduce(self.pool.factor[terms])[0]
            psi = np.linalg.solve(back.T, theta)
            theta = theta - psi[place] * back[place]
        return fewer, np.delete(theta, place)

    def candidates(self, terms, theta):
        """The shortlist, and the Gram matrix of chosen and shortlisted columns."""
        network = self.network(terms, theta, self.slots)
        anchor = self.task.anchors(None)
        g, norm, loss = pool_derivatives(
            network,
            self.task.drive,
            anchor,
            self.task.weight,
            self.pool.factor,
            self.position,
            self.offset,
        )
        g, norm = np.asarray(g), np.asarray(norm)
        open_ = self.usable & (norm > 0)
        open_ &= self.admissible_terms(terms)
        open_[terms] = False
        score = np.where(open_, g**2 / np.where(open_, norm, 1.0), -np.inf)
        count = min(self.method.shortlist, int(open_.sum()))
        short = np.argsort(-score, kind="stable")[:count].tolist()
        slots = self.slots + self.method.shortlist
        both = [*terms, *short]
        wide = self.network(both, np.r_[theta, np.zeros(len(short))], slots)
        layout = self.layout(wide)
        _, slope, gram = normal_equations(
            layout, layout.gather(wide), self.task.drive, anchor, self.task.weight
        )
        size = len(both)
        return short, np.asarray(slope)[:size], np.asarray(gram)[:size, :size], loss

    def try_term(self, terms, theta, solution, term: int):
        """After one more term, or with it in the place of another; or as it was.

        The loss falls, by `least_gain` where the model gets larger, or everything
        stays. With all slots taken the new term must push another one out.
        """
        before = float(solution.stats["loss"])
        more = [*terms, term]
        after, tried = self.refine(more, np.r_[theta, 0.0])
        fewer, less, thinner = self.thin(more, after, tried, before)
        if fewer is not None and thinner.stats["loss"] < before:
            dropped = next(t for t in more if t not in fewer)
            self.tell(fewer, term, thinner, f"taken in for {self.pool.name(dropped)}")
            return fewer, less, thinner
        enough = (1.0 - self.method.least_gain) * before
        if len(more) <= self.method.max_terms and tried.stats["loss"] < enough:
            self.tell(more, term, tried, "taken in")
            return more, after, tried
        self.tell(terms, term, solution, "refused")
        return terms, theta, solution

    def thin(self, terms, theta, solution, before: float):
        """The terms without the one that costs least, the newest excepted; or None for
        terms.

        None where the loss would come out above `before`, unless a term must go.
        """
        network = self.network(terms, theta, self.slots)
        layout = self.layout(network)
        _, _, gram = normal_equations(
            layout,
            layout.gather(network),
            self.task.drive,
            self.task.anchors(None),
            self.task.weight,
        )
        size = len(terms)
        value = np.asarray(layout.gather(network))[:size]
        cost = costs(value, np.asarray(gram)[:size, :size])
        if self.parents is not None:
            # A part of another term stays.
            cost[np.isin(terms, self.parents[terms])] = np.inf
        weakest = int(np.argmin(cost[:-1]))
        loss = float(solution.stats["loss"])
        full = size > self.method.max_terms
        if not full and loss + cost[weakest] >= before:
            return None, theta, solution
        fewer, rest = self.remove_term(terms, theta, weakest)
        after, tried = self.refine(fewer, rest)
        return fewer, after, tried

    def tell(self, terms: list[int], term: int, solution, what: str) -> None:
        """Write a row of the history, and show it."""
        row = {
            "round": len(self.history) + 1,
            "terms": len(terms),
            "of": self.method.max_terms,
            "term": self.pool.name(term),
            "what": what,
            "loss": float(solution.stats["loss"]),
        }
        self.history.append(row)
        if self.progress is not None:
            self.progress(row)


def promises(
    slope: Float[np.ndarray, " all"], gram: Float[np.ndarray, "all all"], chosen: int
) -> tuple[Float[np.ndarray, " new"], Float[np.ndarray, " new"]]:
    """Decrease of the loss each new column promises beside the first `chosen` ones.

    Also the share of its squared norm that it keeps beside them.
    """
    scale = np.sqrt(np.maximum(np.diagonal(gram), np.finfo(float).tiny))
    a = gram[:chosen, :chosen] / np.outer(scale[:chosen], scale[:chosen])
    a[np.diag_indices(chosen)] += 1e-12
    b = gram[:chosen, chosen:] / np.outer(scale[:chosen], scale[chosen:])
    factor = scipy.linalg.cho_factor(a)
    left = 1.0 - np.sum(b * scipy.linalg.cho_solve(factor, b), axis=0)
    inner = scipy.linalg.cho_solve(factor, slope[:chosen] / scale[:chosen])
    g = slope[chosen:] / scale[chosen:] - b.T @ inner
    safe = np.maximum(left, np.finfo(float).eps)
    return np.where(left > 0, g**2 / safe, 0.0), left


def costs(
    theta: Float[np.ndarray, " chosen"], gram: Float[np.ndarray, "chosen chosen"]
) -> Float[np.ndarray, " chosen"]:
    """Increase of the loss by leaving out each chosen term, the others adapted."""
    scale = np.sqrt(np.maximum(np.diagonal(gram), np.finfo(float).tiny))
    a = gram / np.outer(scale, scale)
    a[np.diag_indices(len(a))] += 1e-12
    return (theta * scale) ** 2 / np.diagonal(np.linalg.inv(a))


def simulation_ols(
    pool: Pool,
    data: Dataset,
    gain: Float[np.ndarray, " signals"],
    start: list[int],
    theta: Float[np.ndarray, " start"],
    method: SimulationOLS,
    usable: Bool[np.ndarray, " terms"],
    progress: Progress | None = None,
) -> Found:
    """Grow `start` to `method.max_terms` terms on the free-run error of `data`."""
    r = _Rounds(pool, data, gain, method, usable, progress)
    terms = list(start)
    theta, solution = r.refine(terms, theta, first=True)
    if solution.stats["start_diverged"] and solution.status == RESULTS.start_diverged:
        return Found(
            solution.value,
            terms,
            solution.stats["loss"],
            [],
            solution.status,
            "the start does not run freely: " + solution.detail,
        )
    status, detail = RESULTS.no_improvement, ""
    mark, idle = float(solution.stats["loss"]), 0
    while idle <= method.patience:
        if len(r.history) == method.max_rounds:
            status = RESULTS.budget_spent
            break
        short, slope, gram, loss = r.candidates(terms, theta)
        if not np.all(np.isfinite(gram)):
            status = RESULTS.diverged
            detail = "the run is so unstable that its sensitivities overflow"
            break
        gained, left = promises(slope, gram, len(terms))
        gained = np.where(left > method.tau, gained, 0.0)
        if not short or not np.max(gained) > 0.0:
            status, detail = RESULTS.pool_exhausted, f"{len(terms)} terms qualify"
            break
        best, loss = int(np.argmax(gained)), float(loss)
        if gained[best] < method.least_gain * loss:
            break
        term = short[best]
        r.usable[term] = False
        terms, theta, solution = r.try_term(terms, theta, solution, term)
        idle += 1
        if float(solution.stats["loss"]) < (1.0 - method.least_gain) * mark:
            mark, idle = float(solution.stats["loss"]), 0
    if len(terms) == method.max_terms and status == RESULTS.no_improvement:
        status = RESULTS.ok
    elif status == RESULTS.no_improvement:
        detail = f"no further term made the free run better (loss {mark:.4g})"
    network = r.network(terms, theta, len(terms))
    return Found(
        network, terms, float(solution.stats["loss"]), r.history, status, detail
    )
