"""What the records of one engine say about its coefficients.

About coefficients u the free run is linear to first order, y(u + d) = y(u) + J d, so
that the squared error of every output is

    |y - y_m|^2 = s + 2 d'b + d'G d ,   s = r'r ,  b = J'r ,  G = J'J ,

summed over the samples of every part of the records: where a run is linear in its
coefficients, exactly.
"""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import program
from jaxnarx.fleet.coefficients import FleetCoefficients
from jaxnarx.models import Network
from jaxnarx.refinement import stream
from jaxnarx.simulation import Prepared, first_anchor, start_hidden, states

Arrays = Array | np.ndarray

WARM_UP_SHARE = 0.1
"""Share of a record in which filters may warm up."""
FEWEST_LEFT = 5
"""Samples that must be left behind that."""


class Information(NamedTuple):
    """Sums over samples; leading axes of engines and of parts of their records."""

    square: Float[Arrays, "*many outputs"]
    right: Float[Arrays, "*many outputs params"]
    gram: Float[Arrays, "*many outputs params params"]
    samples: Float[Arrays, "*many outputs"]

    def loss(
        self, step: Float[Arrays, "*many params"]
    ) -> Float[np.ndarray, "*many outputs"]:
        """Squared errors a step away; host."""
        linear = np.einsum("...op,...p->...o", self.right, step)
        bent = np.einsum("...opq,...p,...q->...o", self.gram, step, step)
        return np.maximum(np.asarray(self.square) + 2 * linear + bent, 0.0)

    def shift(self, step: Float[np.ndarray, " params"]) -> "Information":
        """The same sums told about a place a step away; host."""
        gram, right = np.asarray(self.gram), np.asarray(self.right)
        bent = np.einsum("...opq,q->...op", gram, step)
        square = np.asarray(self.square) + (2 * right + bent) @ step
        return Information(square, right + bent, gram, self.samples)

    def total(self) -> "Information":
        """The sums over all parts, the axis before the outputs."""
        axes = (-2, -3, -4, -2)
        pairs = zip(self, axes, strict=True)
        return Information(*(np.asarray(a).sum(axis=axis) for a, axis in pairs))


@program
def gather_information(
    coefficients: FleetCoefficients,
    v: Float[Array, " params"],
    runs: Prepared,
    part: Int[Array, "records time"],
    parts: int,
) -> Information:
    """Sums of the free run of prepared records, by part; part -1 counts nowhere."""
    layout, u = coefficients.layout, coefficients.vector(v)
    network = layout.place(u)
    anchor = jnp.asarray(first_anchor(runs))
    drive = start_hidden(network, runs).drive
    every = states(network, drive, anchor)
    outputs = runs.scored.shape[-1]
    error = every[..., :outputs] - drive.measured[..., :outputs]
    member = (part[..., None] == jnp.arange(parts)[None, None])[:, :, None]
    member = member & runs.scored[..., None]
    slope = layout.slope(u)[coefficients.free] * coefficients.scale
    free = coefficients.free

    def direct(tangents, seen, time, record):
        del seen, time, record
        return tangents

    def consume(carry, s, block):
        error, member = block
        # Unscored stretches may be unstable: what overflows there must not count.
        counted = member.any(axis=3)
        j = jnp.where(
            counted[..., None], s[:, :, :outputs, free] * slope[None, None, None], 0.0
        )
        r = jnp.where(counted, error, 0.0)
        share = member.astype(j.dtype)
        return Information(
            carry.square + jnp.einsum("rtok,rto->ko", share, r**2),
            carry.right + jnp.einsum("rtok,rtop,rto->kop", share, j, r),
            carry.gram + jnp.einsum("rtok,rtop,rtoq->kopq", share, j, j),
            carry.samples + share.sum(axis=(0, 1)).T,
        ), None

    params, kind = len(free), every.dtype

    def zeros(*size):
        return jnp.zeros((parts, outputs, *size), kind)

    empty = Information(zeros(), zeros(params), zeros(params, params), zeros())
    columns = layout.low.shape[0]
    finished = network, layout, every, drive, anchor
    rest = direct, columns, consume, empty, (error, member)
    return stream(*finished, *rest)[0]


def warm_up(network: Network, lengths: Iterable[int]) -> int:
    """Samples at the begin of records in which filtered inputs remember a past that
    nobody measured: the slowest filter's time, a tenth of the usual record at most."""
    tables = [network.variables, *(m.scheduling for m in network.models)]
    poles = [p for t in tables for f in t.filters if f is not None for p in f.sections]
    slow = max((-1.0 / p.real for p in poles), default=0.0)
    usual = float(np.median(list(lengths)))
    return int(min(slow / float(network.sample_time), WARM_UP_SHARE * usual))


def skip_begin(runs: Prepared, samples: int) -> Prepared:
    """Records of which the first so many samples count nowhere, where others do."""
    later = np.asarray(runs.scored).copy()
    later[:, :samples] = False
    if later.any(axis=2).sum() < FEWEST_LEFT:
        return runs
    return dataclasses.replace(runs, scored=jax.device_put(later), origin=None)


def parts_of(runs: Prepared, rungs: tuple[int, ...]) -> Int[np.ndarray, "records time"]:
    """The part of every sample: before so many scored ones, between two such numbers,
    and behind the last."""
    counted = np.asarray(runs.scored).any(axis=2)
    count = np.cumsum(counted.reshape(-1)).reshape(counted.shape)
    part = np.searchsorted(np.array(rungs, int), count - 1, side="right")
    return np.where(counted, part, -1)
