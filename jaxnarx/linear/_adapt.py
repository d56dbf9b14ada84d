"""The verb `adapt`: update the coefficients of a network while it runs.

Every sample corrects the coefficients by recursive least squares with forgetting, see
`arrays.recursive_least_squares`, and the partition stays. With `regressors="measured"`
the regressors hold measured outputs: the estimate is that of one-step least squares.
With `"simulated"` they hold the model's own outputs, as in a free run: what is then
minimised is nearer to the simulation error, but convergence is certain only where the
error's filter is positive real (L. Ljung, T. Soderstrom, Theory and Practice of
Recursive Identification, 1983, chapter 4).
"""

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
from jaxnarx.models import Network, depth
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

    Coefficients and their covariance pass from record to record; samples that are
    missing, or whose lags are, count for nothing. A sample is *frozen* where the error
    lies in the dead zone or where it brings too little news, not used outside of the
    domain (`Recursive.largest_index`), *held* where its news
    count but nothing is forgotten, the covariance being at its bound: a constant input
    then neither moves the coefficients nor makes them jump when it moves again.

    After every `window` samples the root mean square error of the predictions made on
    the way is compared with that of the starting network: above `growth` times it the
    window is undone, that is, the coefficients go back to those before, or, where the
    window before was undone too, to those of the start, and the covariance begins anew.

    `stats`, with a row for every window: `rmse` and `rmse_start` (windows, outputs) in
    physical units, `drift`, the root mean square difference of both predictions, and
    `history` (one array per output: windows, models, slots; scaled coefficients as the
    network holds them), `undone`; per output the numbers of `samples`, `frozen`, `held`
    and `restarts`; and how many samples are `outside` of the domain.

    Status `no_improvement` where a window was undone, `stalled` where all of one output
    were, `unidentifiable` where not one sample was used. No usable sample: `DataError`.
    """
    network.require_measured("Adaptation")
    network.require_no_roots("Adaptation")
    method = Recursive() if method is None else method
    plan = make_plan(network, method)
    matched = match_records(network, data)
    simulated = method.regressors == "simulated"
    known = _inside(network, matched, method.largest_index)
    samples = _samples(network, matched, known, method.window, simulated)
    dtype = samples.v.dtype
    limits = Limits(*(jnp.asarray(getattr(method, f), dtype) for f in Limits._fields))
    theta, record = adapt_windows(network, plan, samples, limits, simulated)
    value = place(network, plan, theta)
    stats = _stats(network, record) | {"outside": np.count_nonzero(~known)}
    return Solution(value, *_status(network, stats))


def _inside(
    network: Network, data: Dataset, largest: float | None
) -> Bool[np.ndarray, "records time"]:
    """Samples at which the network's domain knows the inputs."""
    longest = max(len(r) for r in data)
    inside = np.full((len(data), longest), True)
    if network.domain is not None and largest is not None:
        for row, index in zip(inside, domain(network, data).value.index, strict=True):
            row[: len(index)] = index <= largest
    return inside


def _samples(
    network: Network,
    data: Dataset,
    known: Bool[np.ndarray, "records time"],
    window: int,
    simulated: bool,
) -> WindowedSamples:
    """Every record behind the other, in windows; padding has weight zero."""
    batch = stack_records(data)
    masks = make_masks(network, batch)
    if not np.any(masks.scored & (simulated | masks.anchors[:, :, None])):
        raise DataError(
            f"no sample can be used: the model needs {network.history} valid measured "
            f"samples in a row before one, the longest record has "
            f"{max(len(r) for r in data)} rows"
        )
    whole = usable(batch.valid, _complete_rows(network, simulated), network.history)
    seen = masks.scored & whole[:, :, None]
    seen[:, : known.shape[1]] &= known[:, :, None]
    drive, anchor = make_drive(network, batch), first_anchor(masks)
    if simulated:
        start = run(network, drive, jnp.asarray(anchor))
    else:
        start = run_steps(network, drive, jnp.asarray(1))[0]
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
    longest = max(len(r) for r in data)
    cut = partial(_windows, longest=longest, window=window)
    return WindowedSamples(*jax.tree.map(cut, every))


def _complete_rows(network: Network, simulated: bool) -> tuple[tuple[int, int], ...]:
    """Signals and lags that a sample is learnt from: all that is between, too, so that
    a control unit need only count."""
    inputs = [(s, lag) for s in network.used for lag in range(network.history + 1)]
    tables = (network.variables, *(m.scheduling for m in network.models))
    if simulated or all(s not in network.signals for t in tables for s, _ in t):
        return tuple(inputs)
    past = [(s, lag + 1) for s in network.signals for lag in range(network.history)]
    return (*inputs, *past)


def _windows(a: jax.Array, longest: int, window: int) -> jax.Array:
    """(records, time, ...) as (windows, window, ...), zeros behind the last."""
    a = a[:, :longest]
    flat = a.reshape(a.shape[0] * a.shape[1], *a.shape[2:])
    more = -len(flat) % window
    flat = jnp.pad(flat, ((0, more), *((0, 0) for _ in flat.shape[1:])))
    return flat.reshape(len(flat) // window, window, *flat.shape[1:])


def _stats(network: Network, record: WindowRecord) -> dict:
    gain = np.asarray(network.gain)[np.array(network.signals)]
    return {
        "rmse": np.sqrt(np.asarray(record.mse)) * gain,
        "rmse_start": np.sqrt(np.asarray(record.mse_start)) * gain,
        "drift": np.sqrt(np.asarray(record.drift)) * gain,
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
            f"all {stats['outside']} samples lie outside of the network's domain and "
            "taught nothing; identify anew, or raise largest_index"
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
