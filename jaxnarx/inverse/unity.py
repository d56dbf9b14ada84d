"""The check of a compensated plant: static gain and frequency response of a cascade."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.checks import whole
from jaxnarx.data import Dataset
from jaxnarx.inverse.loop import Loop, connect, run_record
from jaxnarx.inverse.task import CascadeTask, make_task
from jaxnarx.models import Network
from jaxnarx.settings import ActuatorLimits
from jaxnarx.solution import RESULTS, Solution

SETTLED_SHARE = 1e-3
"""Change over the last quarter of the settling time, as a share of the training range,
below which an output has settled."""


@dataclasses.dataclass(frozen=True, eq=False)
class UnityGain:
    """A cascade linearised at rest, at several operating points; physical units.

    `place` holds the signals `place_names` of every point, `reference` the references
    and `output` the values at which the targets have come to rest. `gain[p, i, j]` is
    the static gain from reference j to target i, `response[p, f, i, j]` the complex one
    at `frequency` f [Hz], against the reference at the same instant. `settled` is False
    where the output was still moving or its response had not died out, `held` True
    where a limit acted at rest (the gain by that command is then zero).
    """

    place_names: tuple[str, ...]
    target_names: tuple[str, ...]
    place: Float[np.ndarray, "points signals"]
    reference: Float[np.ndarray, "points targets"]
    output: Float[np.ndarray, "points targets"]
    gain: Float[np.ndarray, "points targets targets"]
    frequency: Float[np.ndarray, " frequencies"]
    response: Complex[np.ndarray, "points frequencies targets targets"]
    settled: Bool[np.ndarray, " points"]
    held: Bool[np.ndarray, " points"]

    def worst(self) -> float:
        """Largest distance of the static gain from the unit matrix over the points
        that have settled free of limits; `inf` without any."""
        good = self.settled & ~self.held
        unit = np.eye(self.gain.shape[1])[None]
        return float(np.abs(self.gain[good] - unit).max()) if good.any() else np.inf


@guard_arguments
def unity_gain(
    inverse: Network,
    forward: Network,
    data: Dataset,
    *,
    points: int = 20,
    settle: int = 200,
    frequencies: int = 16,
    limits: ActuatorLimits | None = None,
) -> Solution[UnityGain]:
    """Static gain and frequency response of reference to output over `data`.

    At each of `points` measured samples (evenly spaced) all signals are held, the
    cascade comes to rest for `settle` samples, and the derivative of its outputs by a
    pulse of each reference is followed for `settle` more. With h that pulse response
    and t_0 the instant of the pulse,

        gain = sum_t h(t),   response(f) = sum_t h(t) exp(-2 pi i f (t - t_0) T).

    It begins before t_0 where the inverse sees ahead. `frequencies` are spread
    logarithmically up to half the sampling rate. A perfect compensation has gain one.

    Status `ok`; `diverged` where no point has come to rest, with more `settle` to try.
    """
    whole(points, "points")
    whole(settle, "settle", 4)
    loop = connect(inverse, forward, limits)
    task = make_task(loop, data)
    place = _places(task, points)
    before = loop.history + max(k for _, k in loop.wiring.source)
    z, pulse = _respond(loop, jnp.asarray(place), before, settle)
    value = _value(loop, place, np.asarray(z), np.asarray(pulse), settle, frequencies)
    stats = {
        "worst": value.worst(),
        "settled": float(value.settled.mean()),
        "held": float(value.held.mean()),
    }
    if not value.settled.any():
        detail = f"no point has come to rest in {settle} samples; allow more to settle"
        return Solution(value, RESULTS.diverged, stats, detail)
    return Solution(value, RESULTS.ok, stats)


def _places(task: CascadeTask, points: int) -> Float[np.ndarray, "points signals"]:
    """Signals at samples from which a run could start."""
    good = np.flatnonzero(task.anchors)
    at = good[np.unique(np.linspace(0, len(good) - 1, points).astype(int))]
    signals = np.asarray(task.batch.signals)
    return signals.reshape(-1, signals.shape[-1])[at]


@program
def _respond(
    loop: Loop, place: Float[Array, "points signals"], before: int, settle: int
) -> tuple[Float[Array, "points time states"], Float[Array, "points targets time out"]]:
    """Runs at constant signals, and the targets' derivatives by a pulse of each.

    The pulse stands at sample `before` + `settle`. Physical units.
    """
    time = before + 2 * settle
    at = jnp.arange(time)
    outputs = np.array(loop.forward.signals)[np.array(loop.wiring.targets)]
    shown = loop.low.shape[0] + np.array(loop.wiring.targets)
    gain = loop.output_gain[np.array(loop.wiring.targets)]

    def one(place):
        signals = jnp.tile(place[None], (time, 1))
        valid = jnp.ones(signals.shape, bool)

        def outcome(signals):
            return run_record(loop, signals, valid, at == loop.history)

        def pulse_response(signal):
            pulse = jnp.zeros_like(signals).at[before + settle, signal].set(1.0)
            moved = jax.jvp(outcome, (signals,), (pulse,))[1]
            return moved[:, shown] * gain[None]

        return outcome(signals), jax.vmap(pulse_response)(jnp.asarray(outputs))

    return jax.lax.map(one, place)


def _value(
    loop: Loop,
    place: Float[np.ndarray, "points signals"],
    z: Float[np.ndarray, "points time states"],
    pulse: Float[np.ndarray, "points targets time out"],
    settle: int,
    frequencies: int,
) -> UnityGain:
    forward, targets = loop.forward, list(loop.wiring.targets)
    signals = np.array(forward.signals)[targets]
    count, at = len(loop.low), z.shape[1] - settle
    y = z[:, :, count + np.array(targets)] * np.asarray(loop.output_gain)[targets]
    # Before the start the run has no meaning.
    pulse = np.where(np.arange(z.shape[1]) >= loop.history, pulse.swapaxes(2, 3), 0.0)
    pulse = pulse.swapaxes(1, 2)
    wide = (np.asarray(forward.high) - np.asarray(forward.low))[signals]
    wide = np.where(wide > 0, wide, 1.0)
    # The pulse's anticipation begins by the largest lead before it.
    rest = at - 1 - max(k for _, k in loop.wiring.source)
    moved = np.abs(y[:, rest] - y[:, rest - settle // 4]) / wide
    tail = np.abs(pulse[..., -max(settle // 4, 1) :]).sum(axis=-1)
    died = (tail < SETTLED_SHARE * np.maximum(np.abs(pulse).sum(axis=-1), 1e-12)).all(
        (1, 2)
    )
    hertz = 0.5 / float(forward.sample_time)
    frequency = np.geomspace(hertz / settle, hertz, frequencies)
    instant = (np.arange(z.shape[1]) - at) * float(forward.sample_time)
    kernel = np.exp(-2j * np.pi * frequency[:, None] * instant[None])
    return UnityGain(
        place_names=tuple(forward.channels.names),
        target_names=tuple(forward.output_names[o] for o in targets),
        place=place,
        reference=place[:, signals],
        output=y[:, rest],
        gain=pulse.sum(axis=-1),
        frequency=frequency,
        response=np.einsum("pijt,ft->pfij", pulse, kernel),
        settled=(moved < SETTLED_SHARE).all(axis=1) & died,
        held=_is_at_limit(loop, z[:, rest]),
    )


def _is_at_limit(
    loop: Loop, z: Float[np.ndarray, "points states"]
) -> Bool[np.ndarray, " points"]:
    """The samples at which a command or an output rests at its limit."""
    count, shown = len(loop.low), len(loop.forward.models)
    u = z[:, :count] * np.asarray(loop.command_gain)
    low, high = np.asarray(loop.low), np.asarray(loop.high)
    near = 1e-9 * (high - low)
    y = z[:, count : count + shown]
    lower, upper = np.asarray(loop.forward.lower), np.asarray(loop.forward.upper)
    at_range = (u <= low + near) | (u >= high - near)
    held = np.concatenate([at_range, y <= lower, y >= upper], axis=1)
    return np.logical_or.reduce(held, axis=1)
