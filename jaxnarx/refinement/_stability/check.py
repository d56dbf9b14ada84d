"""The verb `stability`: poles, a contraction bound, and where it fails."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import whole
from jaxnarx.data import Dataset
from jaxnarx.formatting import page
from jaxnarx.models import Network
from jaxnarx.refinement._stability._certificate import (
    Certificate,
    certificate,
    stays_bounded,
)
from jaxnarx.refinement._stability.bound import RUN_WORDS, Bound, bounds
from jaxnarx.refinement._stability.points import choose_points
from jaxnarx.refinement._stability.poles import Poles, pole_table, time_constant
from jaxnarx.simulation import (
    Masks,
    Prepared,
    RunInputs,
    Trajectories,
    begin_hidden,
    ensure_prepared,
    first_anchor,
    observe_hidden,
    simulate,
    states,
)
from jaxnarx.solution import RESULTS, Solution

POLE_SAMPLES = 2000
"""Samples at which poles are computed; their summaries need no more."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stability:
    """Poles of every local model and of the network, and the bounds that were tried.

    `bounds` go from the strongest claim to the weakest and end with the first that
    holds; claims that an unstable pole refutes are left out. `sample_time` in s. A
    `certificate` holds for every input, beyond these data too, as does that every run
    is `bounded` while its inputs are.
    """

    poles: tuple[Poles, ...]
    bounds: tuple[Bound, ...]
    sample_time: float
    certificate: Certificate | None = None
    bounded: bool = False

    @property
    def bound(self) -> Bound:
        """The bound that holds, or the weakest claim when none does."""
        return self.bounds[-1]

    @property
    def contracts(self) -> bool:
        """Whether two runs with the same inputs were found to approach each other."""
        return self.bound.holds

    @property
    def time_constant(self) -> float:
        """Time [s] in which the distance of two runs falls to 1/e at least; or inf."""
        return time_constant(self.bound.rate) * self.sample_time

    @property
    def summary(self) -> str:
        """The finding in one or two sentences."""
        bound = self.bound
        everywhere = self.certificate or (bound if bound.kind != RUN_WORDS else None)
        if everywhere is not None and everywhere.rate == 0:
            return "Feeds no output back: two runs with the same inputs are the same."
        if self.certificate is not None:
            rate = self.certificate.rate
            constant = time_constant(rate) * self.sample_time
            return (
                "Contracts whatever the inputs, while no bound holds its outputs: "
                "proven by one norm for all its slopes; two runs with the same "
                "inputs approach each other with a time constant of "
                f"{_figure(constant)} s or less (rate {rate:.4f} a sample, overshoot "
                f"up to {_figure(self.certificate.overshoot)})."
            )
        seen = f"{bound.samples} samples"
        if bound.samples < bound.of:
            seen += f" of {bound.of}"
        if bound.holds:
            return (
                "Contracts: two runs with the same inputs approach each other with a "
                f"time constant of {_figure(self.time_constant)} s or less, "
                f"{_claim(bound)} ({seen}; rate {bound.rate:.4f} a sample, overshoot "
                f"up to {_figure(bound.overshoot)})."
            )
        place = bound.worst
        where = ", ".join(f"{k} {_figure(v)}" for k, v in place.scheduling.items())
        text = (
            f"No contraction bound: it fails at {100 * bound.fails:.3g} % of {seen}, "
            f"worst in record {place.record!r} at {_figure(place.time)} s"
            + (f" ({where})" if where else "")
            + "."
        )
        if bound.average < 1:
            text += f" On average steps contract by {bound.average:.4f}."
        if self.bounded:
            text += " Every run stays bounded while its inputs do: proven."
        return text

    @property
    def table(self) -> str:
        """Poles as aligned text, the summary below."""
        head = ("", "model", "samples", "median", "95 %", "largest", ">= 1", "time [s]")
        lines = [head, *map(_cells, self.poles)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
        text = [
            "  ".join(
                [line[0].ljust(widths[0])]
                + [c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True)]
            )
            for line in lines
        ]
        rule = "-" * len(text[0])
        body = [rule, text[0], rule, *text[1:], rule]
        return "\n".join(["moduli of the poles, per sample", *body, self.summary])

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page


def _claim(bound: Bound) -> str:
    limits = "also where limited" if bound.limits else "while neither is limited"
    return f"{bound.kind}, {limits}"


def _figure(value: float) -> str:
    return format(value, ".4g") if math.isfinite(value) else "infinite"


def _cells(row: Poles) -> tuple[str, ...]:
    moduli = (row.median, row.high, row.largest)
    return (
        row.output,
        "" if row.model is None else str(row.model),
        str(row.samples),
        *(f"{m:.4f}" for m in moduli),
        f"{100 * row.unstable:.3g} %",
        _figure(row.time_constant),
    )


def _own_outputs(
    network: Network, drive: RunInputs, masks: Masks, run: Trajectories
) -> np.ndarray:
    """The outputs that a finished run has carried, scaled and padded as the drive is.

    No trajectory has the outputs of local models with feedback of their own: these are
    run again.
    """
    if network.parallel:
        drive = begin_hidden(network, drive, jnp.asarray(masks.start))
        return np.asarray(states(network, drive, jnp.asarray(first_anchor(masks))))
    y = np.array(drive.measured, np.float64)
    gain = np.asarray(network.gain, np.float64)[np.array(network.signals)]
    for n, parts in enumerate(zip(run.computed, run.hidden, strict=True)):
        y[n, : len(parts[0])] = np.concatenate(parts, axis=1) / gain
    return y.astype(drive.measured.dtype)


@guard_arguments
def stability(
    network: Network,
    data: Dataset | Prepared,
    *,
    samples: int | None = None,
    simulated: Solution[Trajectories] | None = None,
) -> Solution[Stability]:
    """Poles of the local models and a contraction bound of the network on `data`.

    Poles are those of each local model alone, at measured samples where its validity
    exceeds one half, and of the blended network along its free run. The bound says how
    fast two runs with the same inputs approach each other; `Bound.kind` tells whether
    it is proven for the inputs given or sampled along the run.

    Status `ok`, or `diverged` with record, time and channel when the free run leaves
    its bounds.

    Args:
        network: The model.
        data: Records with its channels, at its sample time.
        samples: Thins the samples the bound is checked on to so many (default: all).
        simulated: The free run of `data` where it is at hand.

    Returns:
        `value` holds `poles`, `bounds` and the `certificate`, if there is one; `stats`
        has `contracts`, `rate`, `fails`, `time_constant`, `certified`, `bounded`.
    """
    if samples is not None:
        samples = whole(samples, "samples")
    runs, origin = ensure_prepared(network, data)
    run = simulate(network, runs) if simulated is None else simulated
    matched, masks = origin.matched, origin.masks
    drive = observe_hidden(network, runs.drive)
    own = _own_outputs(network, drive, masks, run.value)
    visited = choose_points(network, drive, masks, count=samples, outputs=own)
    poles = pole_table(
        network,
        choose_points(network, drive, masks, count=POLE_SAMPLES),
        choose_points(network, drive, masks, count=POLE_SAMPLES, outputs=own),
        matched.sample_time,
    )
    total = int(masks.anchors.sum())
    found = bounds(network, visited, list(matched.names), matched.sample_time, total)
    proven = certificate(network)
    bounded = proven is not None or stays_bounded(network)
    value = Stability(poles, found, float(matched.sample_time), proven, bounded)
    stats = {
        "contracts": value.contracts,
        "rate": value.bound.rate,
        "fails": value.bound.fails,
        "time_constant": value.time_constant,
        "certified": proven is not None,
        "bounded": bounded,
    }
    diverged = any(np.any(bad) for bad in run.value.diverged)
    if diverged:
        keys = ("record", "row", "time", "first_bad_step", "channel")
        stats |= {k: run.stats[k] for k in keys if k in run.stats}
    status = RESULTS.diverged if diverged else RESULTS.ok
    detail = run.detail if diverged else value.summary
    return Solution(value, status, stats, detail)
