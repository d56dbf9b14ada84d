"""LOLIMOT: the worst local model's box is halved, again and again.

Boxes tile the unit cube of the scheduling variables; a box's Gaussian has its middle as
centre and `k_sigma` times its extension as width. Each stage takes the local model with
the largest sum of validity times squared error, tries halving its box in every
dimension, fits only the two new models by least squares weighted with their validity,
and keeps the split with the smallest total squared error. A split is forbidden when
either child's validities sum to less than its number of parameters; a model without an
allowed split is locked and the next worst is tried.

O. Nelles and R. Isermann, "Basis function networks for interpolation of local linear
models", CDC 1996; thesis section 6.2. The published curves need every detail above, and
weights that enter the squared error once, not twice.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.errors import SpecError
from jaxnarx.models import AbstractValidity, Boxes, Compact, Gaussians
from jaxnarx.partition.local_fit import batch_size, effective, local_fit
from jaxnarx.partition.stages import grow_stages


class Growth(eqx.Module):
    """State of the growth at fixed capacity; slots past `count` are empty."""

    low: Float[Array, "models dims"]
    high: Float[Array, "models dims"]
    theta: Float[Array, "models terms"]
    curves: Float[Array, "models rows"]
    output: Float[Array, "models rows"]
    locked: Bool[Array, " models"]
    count: Int[Array, ""]
    sse: Float[Array, ""]
    going: Bool[Array, ""]


class LolimotStage(eqx.Module):
    """One stage of the growth as it is kept: the network so far and its figures."""

    low: Float[Array, "models dims"]
    high: Float[Array, "models dims"]
    theta: Float[Array, "models terms"]
    count: Int[Array, ""]
    sse: Float[Array, ""]
    effective: Float[Array, ""]


def validity_of_boxes(kind: str, low, high, k_sigma) -> AbstractValidity:
    """Validity functions of boxes: `"gaussians"`, `"compact"` or `"boxes"`."""
    if kind == "boxes":
        return Boxes(low, high)
    extension = jnp.where(high > low, high - low, 1.0)
    if kind == "compact":
        return Compact(low, high, jnp.log(k_sigma * extension))
    return Gaussians((low + high) / 2, jnp.log(k_sigma * extension))


def boxes_of_validity(kind: str, validity: AbstractValidity, k_sigma):
    """Lower and upper corners of boxes that have these validity functions.

    The inverse of `validity_of_boxes`: of Gaussians at any place and of any width, and
    of compact curves up to their margins, which become `k_sigma` times the extension.
    """
    if kind == "gaussians" and isinstance(validity, Gaussians):
        half = jnp.exp(validity.log_width) / (2 * k_sigma)
        return validity.centre - half, validity.centre + half
    same = {"compact": Compact, "boxes": Boxes}.get(kind, ())
    if isinstance(validity, Boxes | Compact) and isinstance(validity, same):
        return validity.low, validity.high
    raise SpecError(
        f"the start has {type(validity).__name__}, the growth validity={kind!r}",
        field="start",
    )


def _curve(kind: str, low, high, k_sigma, z) -> Float[Array, " rows"]:
    """Validity of one box before normalisation; zero for an empty one.

    Gaussians are scaled by a common factor: the box that holds a point has at least
    exp(-B) there, B = sum_d (1/(2 k_sigma))^2/2, which may be too small for a number.
    """
    low, high = low[:, None], high[:, None]
    there = jnp.all(high > low)
    if kind == "boxes":
        inside = (z >= low) & ((z < high) | (high >= 1.0))
        return jnp.where(there, jnp.all(inside, axis=0), False).astype(z.dtype)
    extension = jnp.where(high > low, high - low, 1.0)
    if kind == "compact":
        one = Compact(low.T, high.T, jnp.log(k_sigma * extension).T)
        return jnp.where(there, one.curves(z)[0], 0.0)
    away = (z - (low + high) / 2) / (k_sigma * extension)
    least = z.shape[0] / (8.0 * k_sigma**2)
    logit = jnp.minimum(least / 2, 300.0) - 0.5 * jnp.sum(away**2, axis=0)
    return jnp.where(there, jnp.exp(logit), 0.0)


def _share(curve, total):
    """Curves over their sum, zero where there is none."""
    there = total > 0
    return jnp.where(there, curve / jnp.where(there, total, 1.0), 0.0)


def _local_nmse(phi, weight, e, y):
    """Var(e)/Var(y) of every local model's own samples, thesis (6.8)."""
    w = phi * weight[None]
    mass = jnp.sum(w, axis=1)
    mass = jnp.where(mass > 0, mass, 1.0)

    def variance(x):
        mean = w @ x / mass
        return jnp.sum(w * (x[None] - mean[:, None]) ** 2, axis=1) / mass

    spread = variance(jnp.where(weight > 0, y, 0.0))
    return jnp.where(spread > 0, variance(e) / jnp.where(spread > 0, spread, 1.0), 0.0)


def lolimot(
    p: Float[Array, "terms rows"],
    z: Float[Array, "dims rows"],
    y: Float[Array, " rows"],
    weight: Float[Array, " rows"],
    *,
    k_sigma: Float[Array, ""],
    ridge: Float[Array, ""],
    least: Float[Array, ""],
    max_models: int,
    kind: str = "gaussians",
    worst: str = "squares",
    picks: int | None = None,
    first: int | None = None,
    start: tuple[Float[Array, "given dims"], Float[Array, "given dims"]] | None = None,
) -> LolimotStage:
    """Grow to `max_models`; returns every stage, stacked, the start first.

    `start` holds the lower and upper corners of the boxes to begin with, whose local
    models are fitted first; default: one box, and stages = max_models. `p` holds the
    regressors of every local model, `z` the scheduling variables scaled to [0, 1]. A
    split is allowed where both children have validities that sum to `least` or more.
    Once no split is allowed the remaining stages repeat the last. `worst` is
    `"squares"` or `"nmse"`; `ridge`, `picks` and `first` are those of `local_fit`.

    Curves and outputs of all local models are carried along. A split changes two of
    them: what the others add to the numerator and the denominator of the network's
    output is summed once for the trials in all dimensions.
    """
    terms, dims = p.shape[0], z.shape[0]
    slots = jnp.arange(max_models)
    if kind != "gaussians":
        z = jnp.clip(z, 0.0, 1.0)

    def fit(w, prior, pull):
        return local_fit(p, y, w, prior=prior, ridge=pull, picks=picks, first=first)

    def curve(low, high):
        return _curve(kind, low, high, k_sigma, z)

    def squares(output):
        return jnp.where(weight > 0, weight * (y - output) ** 2, 0.0)

    def trial(s: Growth, parent, rest, d):
        """Two boxes in the parent's place, their models, and the squared error."""
        bottom, top = s.low[parent], s.high[parent]
        middle = (bottom[d] + top[d]) / 2
        low = jnp.stack([bottom, bottom.at[d].set(middle)])
        high = jnp.stack([top.at[d].set(middle), top])
        curves = jax.vmap(curve)(low, high)
        total = rest[0] + jnp.sum(curves, axis=0)
        phi = _share(curves, total[None])
        own = s.theta[parent]
        theta = jax.lax.map(
            lambda f: fit(f * weight, own, ridge), phi, batch_size=batch_size(p, 2)
        )
        output = theta @ p
        sse = jnp.sum(squares(_share(rest[1], total) + jnp.sum(phi * output, axis=0)))
        mass = jnp.sum(jnp.where(weight[None] > 0, phi, 0.0), axis=1)
        sse = jnp.where(jnp.all(mass >= least), sse, jnp.inf)
        return low, high, theta, curves, output, sse

    def attempt(s: Growth):
        """Split the worst unlocked model, or lock it."""
        total = jnp.sum(s.curves, axis=0)
        blend = _share(jnp.sum(s.curves * s.output, axis=0), total)
        phi = _share(s.curves, total[None])
        if worst == "nmse":
            e = jnp.where(weight > 0, y - blend, 0.0)
            loss = _local_nmse(phi, weight, e, y)
        else:
            loss = phi @ squares(blend)
        free = (slots < s.count) & ~s.locked
        parent = jnp.argmax(jnp.where(free, loss, -jnp.inf))
        others = jnp.where((slots != parent)[:, None], s.curves, 0.0)
        rest = jnp.sum(others, axis=0), jnp.sum(others * s.output, axis=0)
        trials = jax.lax.map(
            lambda d: trial(s, parent, rest, d),
            jnp.arange(dims),
            batch_size=batch_size(p, 2 * dims) // 2 or 1,
        )
        best = jnp.argmin(trials[-1])
        low, high, theta, curves, output, sse = jax.tree.map(lambda a: a[best], trials)
        allowed = jnp.any(free) & jnp.isfinite(sse)
        # Past the capacity, where nothing is allowed, the second place is dropped.
        pair = jnp.stack([parent, s.count])
        pair = jnp.where(allowed, pair, max_models)

        def set_pair(old, new):
            return old.at[pair].set(new, mode="drop")

        return Growth(
            low=set_pair(s.low, low),
            high=set_pair(s.high, high),
            theta=set_pair(s.theta, theta),
            curves=set_pair(s.curves, curves),
            output=set_pair(s.output, output),
            locked=s.locked.at[parent].set(s.locked[parent] | ~allowed),
            count=jnp.where(allowed, s.count + 1, s.count),
            sse=jnp.where(allowed, sse, s.sse),
            going=allowed | jnp.any(free),
        )

    def keep(s: Growth) -> LolimotStage:
        phi = _share(s.curves, jnp.sum(s.curves, axis=0)[None])
        used = (slots < s.count)[:, None]
        used = used & (s.theta != 0) if picks else jnp.broadcast_to(used, s.theta.shape)
        pull = jnp.where(s.count > 1, ridge, 0.0)
        n = effective(p, phi, weight, used, pull)
        return LolimotStage(s.low, s.high, s.theta, s.count, s.sse, n)

    def pad(first):
        return jnp.zeros((max_models, *first.shape[1:]), p.dtype).at[:given].set(first)

    one = jnp.zeros((1, dims), p.dtype)
    low, high = (one, one + 1.0) if start is None else start
    given = len(low)
    curves = jax.vmap(curve)(low, high)
    phi = _share(curves, jnp.sum(curves, axis=0)[None])
    everywhere = fit(weight, jnp.zeros(terms, p.dtype), jnp.zeros_like(ridge))
    theta = everywhere[None]
    if start is not None:
        theta = jax.lax.map(lambda f: fit(f * weight, everywhere, ridge), phi)
    output = theta @ p
    begin = Growth(
        low=pad(low),
        high=pad(high),
        theta=pad(theta),
        curves=pad(curves),
        output=pad(output),
        locked=jnp.zeros(max_models, bool),
        count=jnp.asarray(given),
        sse=jnp.sum(squares(jnp.sum(phi * output, axis=0))),
        going=jnp.asarray(True),
    )
    return grow_stages(begin, attempt, keep, max_models - given)
