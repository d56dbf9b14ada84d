"""The verb `adapt`: update the coefficients of a network while it runs.

Every sample corrects the coefficients by recursive least squares with forgetting, see
`arrays.recursive_least_squares`, and the partition stays. With `regressors="measured"`
the regressors hold measured outputs: the estimate is that of one-step least squares.
With `"simulated"` they hold the model's own outputs, as in a free run: what is then
minimised is nearer to the simulation error, but convergence is certain only where the
error's filter is positive real (L. Ljung, T. Soderstrom, Theory and Practice of
Recursive Identification, 1983, chapter 4).
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import past_outputs, usable
from jaxnarx.confidence import domain
from jaxnarx.data import Dataset, stack_records
from jaxnarx.errors import DataError
from jaxnarx.linear.adapt_program import (
    Limits,
    WindowedSamples,
    WindowRecord,
    adapt_windows,
    make_plan,
    place,
)
from jaxnarx.models import Network, depth, looks_back
from jaxnarx.settings import Recursive
from jaxnarx.simulation import (
    first_anchor,
    make_drive,
    make_masks,
    match_records,
    run,
    run_steps,
)
from jaxnarx.solution import RESULTS, Solution


@guard_arguments
def adapt(
    network: Network, data: Dataset, method: Recursive | None = None
) -> Solution[Network]:
    """The network after it has followed all records of `data` in order.

    Coefficients and their covariance pass from record to record. A sample that is
    missing, or whose lags are, changes nothing, nor does one outside of the network's
    domain (`Recursive.largest_index`). A sample is *frozen* where the error lies in the
    dead zone, or where it says too little about the coefficients. It is *held* where it
    is learnt from and nothing is forgotten, because the covariance is at its bound: a
    constant input then neither moves the coefficients nor makes them jump when it moves
    again.

    After every `window` samples the root mean square error of the predictions made on
    the way is compared with that of the starting network: above `growth` times it the
    window is undone, that is, the coefficients go back to those before, or, where the
    window before was undone too, to those of the start, and the covariance begins anew.

    `stats`: `rmse` and `rmse_start` (windows, outputs) in physical units, and `drift`,
    the root mean square difference of both predictions, NaN in a window without a used
    sample; `history` (one array per output: windows, models, slots; scaled coefficients
    as the network holds them) and `undone` (windows, outputs); by output the numbers of
    `samples`, `frozen`, `held` and `restarts`; the number of samples `outside` of the
    domain, and `window`, the samples of one.

    Status `no_improvement` where a window was undone, `stalled` where all of one output
    were, `unidentifiable` where not one sample was used. No usable sample: `DataError`.
    """
    network.require_measured("Adaptation")
    network.require_no_roots("Adaptation")
    method = Recursive() if method is None else method
    plan = make_plan(network, method)
    matched = match_records(network, data)
    simulated = method.regressors == "simulated"
    known = _known_samples(network, matched, method.largest_index)
    samples = _samples(network, matched, known, method.window, simulated)
    dtype = samples.v.dtype
    limits = Limits(*(jnp.asarray(getattr(method, f), dtype) for f in Limits._fields))
    theta, record = adapt_windows(network, plan, samples, limits, simulated)
    value = place(network, plan, theta)
    outside = sum(int(np.count_nonzero(~inside)) for inside in known)
    stats = _stats(network, record) | {"outside": outside, "window": method.window}
    return Solution(value, *_status(network, stats))


def _known_samples(
    network: Network, data: Dataset, largest: float | None
) -> list[Bool[np.ndarray, " time"]]:
    """Samples of every record that the network's domain does not rule out."""
    if network.domain is None or largest is None:
        return [np.full(len(record), True) for record in data]
    return [index <= largest for index in domain(network, data).value.index]


def _samples(
    network: Network,
    data: Dataset,
    known: Sequence[Bool[np.ndarray, " time"]],
    window: int,
    simulated: bool,
) -> WindowedSamples:
    """Every record behind the other, in windows; padding has weight zero."""
    batch = stack_records(data)
    masks = make_masks(network, batch)
    whole = usable(batch.valid, _complete_rows(network, simulated), network.history)
    anchored = simulated | masks.anchors[:, :, None]
    seen = masks.scored & anchored & whole[:, :, None]
    if not seen.any():
        raise DataError(
            f"no sample can be used: the model needs {network.history} valid measured "
            f"samples in a row before one, the longest record has "
            f"{max(len(r) for r in data)} rows"
        )
    for row, inside in zip(seen, known, strict=True):
        row[: len(inside)] &= inside[:, None]
    drive, anchor = make_drive(network, batch), first_anchor(masks)
    if simulated:
        start = run(network, drive, jnp.asarray(anchor))
    else:
        start = run_steps(network, drive, jnp.asarray(1))[0]
        start = jnp.clip(start, network.lower[None, None], network.upper[None, None])
    past = jax.vmap(partial(past_outputs, depth=depth(network)))(drive.measured)
    dtype = drive.measured.dtype
    every = (
        drive.v.swapaxes(1, 2),
        tuple(x.swapaxes(1, 2) for x in drive.x),
        drive.measured,
        past,
        jnp.asarray(seen, dtype),
        jnp.asarray(anchor),
        start,
    )
    lengths = [len(record) for record in data]
    cut = partial(_windows, lengths=lengths, window=window)
    return WindowedSamples(*jax.tree.map(cut, every))


def _complete_rows(network: Network, simulated: bool) -> tuple[tuple[int, int], ...]:
    """Signals and lags that a sample is learnt from: all that is between, too, so that
    a control unit need only count."""
    inputs = [(s, lag) for s in network.used for lag in range(network.history + 1)]
    if simulated or not looks_back(network):
        return tuple(inputs)
    past = [(s, lag + 1) for s in network.signals for lag in range(network.history)]
    return (*inputs, *past)


def _windows(a: jax.Array, lengths: Sequence[int], window: int) -> jax.Array:
    """(records, time, ...) as (windows, window, ...), zeros behind the last sample."""
    rows = np.concatenate(
        [n * a.shape[1] + np.arange(length) for n, length in enumerate(lengths)]
    )
    flat = a.reshape(a.shape[0] * a.shape[1], *a.shape[2:])[rows]
    more = -len(flat) % window
    flat = jnp.pad(flat, ((0, more), *((0, 0) for _ in flat.shape[1:])))
    return flat.reshape(len(flat) // window, window, *flat.shape[1:])


def _stats(network: Network, record: WindowRecord) -> dict:
    gain = np.asarray(network.gain)[np.array(network.signals)]
    used = np.asarray(record.samples) > 0

    def physical(square) -> np.ndarray:
        return np.where(used, np.sqrt(np.asarray(square)) * gain, np.nan)

    return {
        "rmse": physical(record.mse),
        "rmse_start": physical(record.mse_start),
        "drift": physical(record.drift),
        "undone": np.asarray(record.undone),
        "history": [np.asarray(theta) for theta in record.theta],
        "samples": np.asarray(record.samples).sum(axis=0),
        "frozen": np.asarray(record.frozen).sum(axis=0),
        "held": np.asarray(record.held).sum(axis=0),
        "restarts": np.asarray(record.undone).sum(axis=0),
    }


def _status(network: Network, stats: dict) -> tuple[RESULTS, dict, str]:
    windows, names = len(stats["undone"]), network.output_names

    def describe(output: int, text: str):
        name = names[output]
        return stats | {"channel": name}, f"{name}: {text}"

    if not stats["samples"].any() and stats["outside"]:
        text = (
            "every sample that could be used lies outside of the network's domain, so "
            "nothing was learnt; identify anew, or allow a larger index (largest_index)"
        )
        return RESULTS.unidentifiable, *describe(0, text)
    restarts = stats["restarts"]
    for o in np.flatnonzero(restarts == windows).tolist():
        text = "every window made the error grow and was undone; lower start"
        return RESULTS.stalled, *describe(o, text)
    for o in np.flatnonzero(stats["frozen"] == stats["samples"]).tolist():
        text = "no sample brought news; the coefficients are unchanged"
        return RESULTS.unidentifiable, *describe(o, text)
    for o in np.flatnonzero(restarts).tolist():
        text = f"{restarts[o]} of {windows} windows made the error grow, were undone"
        return RESULTS.no_improvement, *describe(o, text)
    return RESULTS.ok, stats, ""
