"""Scores of one run of a network, record by record and pooled."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx import metrics
from jaxnarx.checks import require_known
from jaxnarx.data import Channel, Dataset
from jaxnarx.errors import SpecError

POOLED_NAME = "pooled"
FREE_RUN = "free run"
CANCELLED_SUM_SHARE = 0.05
"""Size of a measured sum, over that of its magnitudes, up to which it cancels."""


@dataclasses.dataclass(frozen=True)
class Row:
    """The scores of one output in one mode of use, for one record or `"pooled"`.

    `mode` is `"one step"`, `"10 steps"`, ... or `"free run"`. `rmse` has the output's
    unit, `fit` is in percent. `samples` are those that count; `limited`, `held` and
    `extrapolated` tell at how many of them the feedback bound acted, the output was
    held at the edge of its trained range, and the trained range was left; `silent` are
    further samples, of which the model says nothing (`outside="nan"`). A diverged
    row has no metrics (`None`): its figures would only tell where the bound is. Pooled
    rows say how many records diverged in `status`, and `others` holds the pooled
    metrics of the records that did not. `offset` is the mean of measured minus
    predicted. `total_error` is the error of the sum over the samples that count, the
    cycle total, in percent: predicted minus measured over the size of the measured sum;
    None where positive and negative values cancel in that sum.
    """

    part: str
    output: str
    unit: str
    mode: str
    record: str
    rmse: float | None
    nrmse: float | None
    r2: float | None
    fit: float | None
    nmse: float | None
    samples: int
    limited: int
    extrapolated: int
    status: str
    others: dict[str, float] | None = None
    offset: float | None = None
    held: int = 0
    silent: int = 0
    total_error: float | None = None

    @property
    def share_outside(self) -> float:
        """Share of the samples, silent ones among them, outside the trained range."""
        return (self.extrapolated + self.silent) / max(self.samples + self.silent, 1)

    @property
    def diverged(self) -> bool:
        return self.status.startswith("diverged")


@dataclasses.dataclass(frozen=True, eq=False)
class ScoredSamples:
    """Measured and predicted samples of one output of one record."""

    record: str
    measured: Float[np.ndarray, "time 1"]
    predicted: Float[np.ndarray, "time 1"]
    scored: Bool[np.ndarray, "time 1"]
    limited: Bool[np.ndarray, "time 1"]
    held: Bool[np.ndarray, "time 1"]
    extrapolated: Bool[np.ndarray, " time"]
    diverged: bool
    short: bool
    """True for a measured output without a sample that is predicted from complete
    history."""

    @property
    def silent(self) -> Bool[np.ndarray, " time"]:
        """Samples outside the trained range of which the model says nothing."""
        return np.isnan(self.predicted[:, 0]) & self.extrapolated


def mode_name(k: int) -> str:
    """`one step`, or `10 steps`."""
    return "one step" if k == 1 else f"{k} steps"


def collect(
    data: Dataset, outputs: tuple[Channel, ...], run: Any
) -> list[list[ScoredSamples]]:
    """Samples by output, then record. `run` is what `predict` or `simulate` gave."""
    columns = [_column(data, channel.name) for channel in outputs]
    if len(run.outputs) != len(data):
        raise SpecError(
            f"the run has {len(run.outputs)} records and the data {len(data)}; "
            "give the run of this very data",
            field="simulated",
        )
    return [
        [_samples(data, run, r, o, column) for r in range(len(data))]
        for o, column in enumerate(columns)
    ]


def score(
    part: str, mode: str, channel: Channel, samples: list[ScoredSamples]
) -> tuple[Row, ...]:
    """The pooled row first, then one row per record."""

    def row(chosen: list[ScoredSamples], record: str, status: str, others=None) -> Row:
        diverged = status.startswith("diverged")
        return Row(
            part=part,
            output=channel.name,
            unit=channel.unit,
            mode=mode,
            record=record,
            **(dict.fromkeys(metrics.PERFECT_VALUES) if diverged else _metrics(chosen)),
            samples=sum(int(s.scored.sum()) for s in chosen),
            limited=sum(int((s.limited & s.scored).sum()) for s in chosen),
            held=sum(int((s.held & s.scored).sum()) for s in chosen),
            extrapolated=sum(
                int((s.extrapolated & s.scored[:, 0]).sum()) for s in chosen
            ),
            silent=sum(int(s.silent.sum()) for s in chosen),
            status=status,
            others=others,
            **_balance([] if diverged else chosen),
        )

    calm = [s for s in samples if not s.diverged]
    lost = len(samples) - len(calm)
    if lost:
        others = _metrics(calm) if calm else None
        status = f"diverged ({lost} of {len(samples)})"
        rows = [row(samples, POOLED_NAME, status, others)]
    else:
        rows = [row(samples, POOLED_NAME, _status(samples))]
    return tuple(rows + [row([s], s.record, _status([s])) for s in samples])


def _column(data: Dataset, name: str) -> int:
    names = data.channels.output_names
    require_known(
        name,
        names,
        "data",
        f"the model's output {name!r} is not among the data's outputs",
    )
    return names.index(name)


def _samples(data: Dataset, run: Any, r: int, o: int, column: int) -> ScoredSamples:
    record, inputs = data.records[r], len(data.channels.inputs)
    predicted = np.asarray(run.outputs[r])[:, o, None]
    if len(predicted) != len(record):
        raise SpecError(
            f"the run of record {record.name!r} has {len(predicted)} rows and its "
            f"data {len(record)}; give the run of this very data",
            field="simulated",
        )
    scored = np.asarray(run.scored[r])[:, o, None]
    lost = bool(run.diverged[r][o]) or not np.all(np.isfinite(predicted[scored]))
    return ScoredSamples(
        record=record.name,
        measured=record.y[:, column, None],
        predicted=predicted,
        scored=scored,
        limited=np.asarray(run.limited[r])[:, o, None],
        held=np.asarray(run.held[r])[:, o, None],
        extrapolated=np.asarray(run.extrapolated[r]),
        diverged=lost,
        short=not scored.any() and bool(record.valid[:, inputs + column].any()),
    )


def _pool_samples(
    samples: list[ScoredSamples],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        np.concatenate([s.measured for s in samples]),
        np.concatenate([s.predicted for s in samples]),
        np.concatenate([s.scored for s in samples]),
    )


def _metrics(samples: list[ScoredSamples]) -> dict[str, float]:
    values = metrics.scores(*_pool_samples(samples))
    return {name: float(values[name][0]) for name in metrics.PERFECT_VALUES}


def _balance(samples: list[ScoredSamples]) -> dict[str, float | None]:
    """The mean of measured minus predicted, and the error of the sum in percent."""
    if not any(s.scored.any() for s in samples):
        return {"offset": None, "total_error": None}
    measured, predicted, scored = _pool_samples(samples)
    y, error = measured[scored], (measured - predicted)[scored]
    offset, level = float(error.mean()), abs(float(y.mean()))
    cancels = level <= CANCELLED_SUM_SHARE * float(np.abs(y).mean())
    return {
        "offset": offset,
        "total_error": None if cancels else -100.0 * offset / level,
    }


def _status(samples: list[ScoredSamples]) -> str:
    measured, _, scored = _pool_samples(samples)
    if any(s.diverged for s in samples):
        return "diverged"
    if not scored.any():
        return "too short" if any(s.short for s in samples) else "no samples"
    return "constant output" if metrics.is_constant(measured, scored)[0] else "ok"


def nrmse_within(rows: Iterable[Row]) -> dict[tuple[str, str], float]:
    """RMSE over the deviation within records, by output and part, from the rows of one
    mode.

    That deviation is the root of the mean variance of the records; only those count
    whose output moves and whose run stays bounded.
    """
    error: dict[tuple[str, str], float] = {}
    moved: dict[tuple[str, str], float] = {}
    for row in rows:
        if row.record == POOLED_NAME or not row.rmse or not row.nrmse:
            continue
        if np.isfinite(row.nrmse):
            key = (row.output, row.part)
            error[key] = error.get(key, 0.0) + row.samples * row.rmse**2
            spread = row.rmse / row.nrmse
            moved[key] = moved.get(key, 0.0) + row.samples * spread**2
    return {key: float(np.sqrt(error[key] / moved[key])) for key in error}
