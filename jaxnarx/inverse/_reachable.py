"""Reachable references of a plant, and the commands that come nearest to them."""

import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import whole
from jaxnarx.data import Dataset, stack_records
from jaxnarx.inverse.forward import positions
from jaxnarx.inverse.linearise import require_shared
from jaxnarx.inverse.statics import Statics, statics
from jaxnarx.models import Network
from jaxnarx.settings import ActuatorLimits
from jaxnarx.simulation import match_records
from jaxnarx.solution import RESULTS, Solution

REFINEMENT_TRIALS = 12
"""Damped Gauss-Newton trials from the best command of the grid."""
BLOCK_SAMPLES = 64
"""Samples solved at a time."""


@dataclasses.dataclass(frozen=True, eq=False)
class Reach:
    """Sample by sample, one array per record: can the reference be held at rest?

    `commands` come nearest within the limits, `outputs` are where the targets rest
    under them (physical units), `distance` the root mean square over the targets of
    what is left, in training ranges; `reached` where it is at most the tolerance.
    """

    reached: tuple[Bool[np.ndarray, " _"], ...]
    commands: tuple[Float[np.ndarray, "_ commands"], ...]
    outputs: tuple[Float[np.ndarray, "_ targets"], ...]
    distance: tuple[Float[np.ndarray, " _"], ...]
    command_names: tuple[str, ...]
    target_names: tuple[str, ...]

    @property
    def share(self) -> float:
        """Share of the samples whose reference can be held."""
        return float(np.concatenate(self.reached).mean())


class _Aim(eqx.Module):
    """The static map, what is commanded within which bounds, and what is aimed at."""

    map: Statics
    low: Float[Array, " commands"]
    high: Float[Array, " commands"]
    span: Float[Array, " targets"]
    commands: tuple[int, ...] = eqx.field(static=True)
    targets: tuple[int, ...] = eqx.field(static=True)

    def outputs(self, signals: Float[Array, " signals"], share: Float[Array, " c"]):
        """Targets at rest under commands, given as shares of their ranges."""
        u = self.low + share * (self.high - self.low)
        y, found = self.map.rest(signals.at[np.array(self.commands)].set(u))
        network, at = self.map.network, np.array(self.targets)
        return y[at] * network.gain[np.array(network.signals)[at]], found

    def remaining_error(self, signals, share):
        """The rest of the reference in training ranges; large without a state of
        rest."""
        network = self.map.network
        wanted = signals[np.array(network.signals)[np.array(self.targets)]]
        y, found = self.outputs(signals, share)
        return jnp.where(found, (y - wanted) / self.span, 1e3)


@guard_arguments
def reachable(
    forward: Network,
    references: Dataset,
    *,
    commands: Sequence[str],
    targets: Sequence[str],
    limits: ActuatorLimits | None = None,
    grid: int = 9,
    tolerance: float = 0.01,
) -> Solution[Reach]:
    """Compare every sample of `references` with what `forward` can hold at rest.

    At each sample the inputs that are not commanded (and measured outputs that are not
    modelled) are held, and the commands sought under which the targets rest nearest to
    their reference: the best of `grid` values per command, then Gauss-Newton steps
    projected on the range. Ranges are those of `limits`, else of the training. A
    reference counts as reached when the root mean square of what is left is at most
    `tolerance` training ranges. Rates and transients are not looked at: a reference
    that moves too fast is reached here and not tracked by `cascade`.

    Status `ok` when all samples are reached, else `unidentifiable`, with the share in
    `stats["reached"]`. `forward` with local models fed back on their own is refused.
    """
    require_shared(forward)
    whole(grid, "grid", 2)
    data = match_records(forward, references)
    aim = _aim(
        forward, commands, targets, ActuatorLimits() if limits is None else limits
    )
    nodes = np.linspace(0.0, 1.0, grid)
    shares = np.array(list(itertools.product(nodes, repeat=len(aim.commands))))
    batch = stack_records(data)
    flat = np.asarray(batch.signals).reshape(-1, batch.signals.shape[-1])
    real = np.concatenate(
        [np.arange(batch.signals.shape[1]) < len(record) for record in data]
    )
    # Held references repeat: what is the same is solved once.
    ones, back = np.unique(flat[real], axis=0, return_inverse=True)
    pad = -len(ones) % BLOCK_SAMPLES
    ones = np.concatenate([ones, np.repeat(ones[-1:], pad, axis=0)])
    best = _nearest(aim, jnp.asarray(ones), jnp.asarray(shares.astype(flat.dtype)))
    u, y, left = (np.asarray(part)[back.reshape(-1)] for part in best)
    cuts = np.cumsum([len(record) for record in data])[:-1]
    value = Reach(
        tuple(np.split(left <= tolerance, cuts)),
        tuple(np.split(u, cuts)),
        tuple(np.split(y, cuts)),
        tuple(np.split(left, cuts)),
        tuple(commands),
        tuple(targets),
    )
    stats = {"reached": value.share, "distance": float(left.max())}
    if value.share == 1.0:
        return Solution(value, RESULTS.ok, stats)
    detail = (
        f"{1 - value.share:.1%} of the references of {', '.join(targets)} cannot be "
        f"held by {', '.join(commands)} within their ranges; `commands` come nearest"
    )
    return Solution(value, RESULTS.unidentifiable, stats, detail)


def _aim(
    forward: Network,
    commands: Sequence[str],
    targets: Sequence[str],
    limits: ActuatorLimits,
) -> _Aim:
    u, y = positions(forward, commands, targets)
    low, high = (np.asarray(a)[u].copy() for a in (forward.low, forward.high))
    for n, name in enumerate(commands):
        low[n], high[n] = limits.range.get(name, (low[n], high[n]))
    signal = np.array(forward.signals)[y]
    span = (np.asarray(forward.high) - np.asarray(forward.low))[signal]
    span = np.where(span > 0, span, 1.0)
    parts = (jnp.asarray(a) for a in (low, high, span))
    return _Aim(statics(forward), *parts, commands=tuple(u), targets=tuple(y))


@eqx.filter_jit
def _nearest(
    aim: _Aim, signals: Float[Array, "rows signals"], shares: Float[Array, "grid c"]
):
    """Commands, outputs and what is left, for every row."""

    def one(row):
        left = jax.vmap(lambda s: jnp.sum(aim.remaining_error(row, s) ** 2))(shares)
        share, _ = _refine(aim, row, shares[jnp.argmin(left)])
        u = aim.low + share * (aim.high - aim.low)
        rest = jnp.sqrt(jnp.mean(aim.remaining_error(row, share) ** 2))
        return u, aim.outputs(row, share)[0], rest

    return jax.lax.map(one, signals, batch_size=BLOCK_SAMPLES)


def _refine(aim: _Aim, row: Float[Array, " signals"], share: Float[Array, " c"]):
    """Projected Levenberg-Marquardt: a trial is kept where it comes nearer."""

    def step(_, state):
        share, damping = state
        missing = aim.remaining_error(row, share)
        slope = jax.jacfwd(lambda s: aim.remaining_error(row, s))(share)
        # A command that pushes against its limit has no part in the step.
        push = slope.T @ missing
        free = ~(((share <= 0) & (push > 0)) | ((share >= 1) & (push < 0)))
        slope = jnp.where(free[None], slope, 0.0)
        gram = slope.T @ slope
        scale = damping * jnp.maximum(jnp.diagonal(gram), 1e-6)
        move = jnp.linalg.solve(gram + jnp.diag(scale), slope.T @ missing)
        trial = jnp.clip(share - move, 0.0, 1.0)
        better = jnp.sum(aim.remaining_error(row, trial) ** 2) < jnp.sum(missing**2)
        damping = jnp.where(better, damping / 10, damping * 10)
        return jnp.where(better, trial, share), damping

    start = share, jnp.asarray(1e-3, share.dtype)
    return jax.lax.fori_loop(0, REFINEMENT_TRIALS, step, start)
