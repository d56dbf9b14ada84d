"""A look at the data before anything is fitted to them."""

from collections.abc import Iterator

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import whole
from jaxnarx.data import check_samples as samples
from jaxnarx.data._dynamics import Answer, dynamics
from jaxnarx.data.check_inputs import correlations, excitation_order
from jaxnarx.data.compare_records import far_levels, other_units
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.digest import fingerprint
from jaxnarx.data.findings import Finding, Findings


@guard_arguments
def check(data: Dataset, *, max_lag: int = 20) -> Findings:
    """Check `data` for faults that may spoil a model, as a careful engineer would.

    Constant, copied, saturated, stuck and outlying channels, and those far from zero;
    gaps; records that are too short or repeated, or have a channel in another unit than
    the others; missing units; whether inputs excite a model; dead times; long memory;
    and signs of feedback from outputs to inputs. Nothing is changed.

    Args:
        data: The records.
        max_lag: The longest lag [samples] a model shall have, which excitation and
            memory are held against.

    Returns:
        Findings, hints with their places, errors first; `is_okay` while none is an
        error.

    Example:
        print(jnx.check(data, max_lag=10))
    """
    whole(max_lag, "max_lag")
    if not data.samples:
        return Findings((Finding("error", "rows", "the dataset has no samples"),))
    items = [
        *first_look(data, max_lag=max_lag),
        *samples.precision(data),
        *samples.offsets(data),
        *samples.duplicates(data),
        *samples.gaps(data),
        *samples.stuck(data),
        *samples.spikes(data),
        *_excitation(data, max_lag),
        *_dynamics(data, max_lag),
    ]
    return Findings(tuple(items))


def first_look(data: Dataset, *, max_lag: int = 20) -> Findings:
    """Findings that spoil any model: missing units, few rows, copies, constants,
    records in another unit or at levels far apart. A quick part of `check`."""
    items = [
        *_units(data),
        *_rows(data, max_lag),
        *_identical(data),
        *other_units(data),
        *far_levels(data),
        *samples.constant(data),
    ]
    return Findings(tuple(items))


def _units(data: Dataset) -> Iterator[Finding]:
    bare = [c.name for c in data.channels.all if not c.unit]
    if bare:
        yield Finding(
            "note",
            "units",
            f'no unit is stated for {", ".join(bare)}. State them ("1" if there is '
            "none), so that other data can be compared.",
        )


def _rows(data: Dataset, max_lag: int) -> Iterator[Finding]:
    for record in data:
        if len(record) <= 2 * max_lag:
            useless = len(record) <= max_lag
            yield Finding(
                "warning",
                "rows",
                f"{record.name} has {len(record)} rows, "
                + ("none" if useless else "few")
                + f" after lag {max_lag}. Join it to a longer record or leave it out.",
                record=record.name,
            )
    signals = len(data.channels.names)
    usable = sum(max(len(r) - max_lag, 0) for r in data)
    if usable < 10 * signals:
        yield Finding(
            "warning" if usable else "error",
            "rows",
            f"{usable} rows remain after lag {max_lag}; need >= {10 * signals}, ten "
            "for each channel, for even a linear model. Measure longer, or use fewer "
            "lags.",
        )


def _identical(data: Dataset) -> Iterator[Finding]:
    seen, names = dict[str, str](), data.channels.names
    for record in data:
        first = seen.setdefault(fingerprint(record, names), record.name)
        if first != record.name:
            yield Finding(
                "warning",
                "identical",
                f"{record.name} has the same contents as {first}. Leave one out; they "
                "must not serve for training and test.",
                record=record.name,
            )


def _excitation(data: Dataset, max_lag: int) -> Iterator[Finding]:
    wanted = max_lag + 1
    for i, name in enumerate(data.channels.input_names):
        reached = excitation_order(data, i, order=wanted)
        if 0 < reached < wanted:
            yield Finding(
                "warning",
                "excitation",
                f"input {name} is persistently exciting of order {reached} only, lags "
                f"up to {max_lag} need {wanted}. At most {reached} coefficients of its "
                "lags can be told apart: use fewer, or move the input more richly.",
                channel=name,
            )


def _dynamics(data: Dataset, max_lag: int) -> Iterator[Finding]:
    if not data.channels.inputs or max(len(r) for r in data) < 3 * max_lag:
        return
    found, seen = dynamics(data), correlations(data)
    outputs, step = data.channels.output_names, data.sample_time
    for i, u in enumerate(data.channels.input_names):
        for o, y in enumerate(outputs):
            answer = found[i, o]
            if answer is not None and answer.dead_time:
                yield _dead_time(u, y, answer, max_lag, step)
            memory = 0 if answer is None else answer.settling or 0
            if answer is not None and memory > max_lag:
                yield _memory(u, y, memory, answer.rise, max_lag, step)
        yield from _feedback(seen, i, u, outputs, step)


def _memory(
    u: str, y: str, memory: int, rise: float, max_lag: int, step: float
) -> Finding:
    return Finding(
        "note",
        "memory",
        f"{y} remembers {u} for about {memory} samples, {memory * step:.4g} s, longer "
        f"than lags up to {max_lag}: beside them let {u} enter through first-order "
        f"lags of about {rise * step:.2g} s (--filters), or feed the output back.",
        channel=u,
    )


def _dead_time(u: str, y: str, answer: Answer, max_lag: int, step: float) -> Finding:
    dead = answer.dead_time or 0
    low, high = answer.dead_times or (dead, dead)
    told = f"{y} answers {u} after about {_samples(dead)}, {dead * step:.6g} s"
    if high > low:
        told += f" ({low} to {high} explain nearly as much)"
    if late := low > max_lag:
        told += (
            f". Lags up to {max_lag} do not reach it: add some from {max(low, 1)} to "
            f"{high + 1} beside the recent ones"
        )
    severity = "warning" if late else "note"
    return Finding(severity, "dead time", f"{told}.", channel=u)


def _samples(count: int) -> str:
    return f"{count} sample" + "s" * (count != 1)


def _feedback(seen, i, u, outputs, step) -> Iterator[Finding]:
    """Correlation with past outputs, clearly above chance and a fifth of the answer."""
    for o, y in enumerate(outputs):
        past, ahead = abs(seen.past[i, o]), abs(seen.ahead[i, o]).max()
        lag = int(past.argmax())
        if past[lag] > max(1.5 * seen.bound, 0.1, 0.2 * ahead):
            yield Finding(
                "warning",
                "closed loop",
                f"input {u} follows past values of {y} (correlation {past[lag]:.2f} "
                f"after {(lag + 1) * step:.6g} s): the data look as if taken in closed "
                "loop. One-step fits may be biased; excite the set point, or model the "
                "noise.",
                channel=u,
            )
