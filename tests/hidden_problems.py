"""A small nonlinear state-space model: a plain loop, its network, and its records.

    x1 <- 0.2 + 0.7 x1 + 0.2 a - 0.10 x1 x2 ,    y = blend(x1) of two polynomials
    x2 <- -0.1 + 0.5 x2 + 0.9 b + 0.1 x1 a ,     w = 0.4 w(t-1) + 2 x2 + b x1

where the right sides hold the states after the sample before. Of `scheduled` y has two
local models by x1; `plain` is the first of them alone, so that its loop collapses. No
sample depends on one more than `DEPTH` before.
"""

import dataclasses
from functools import cache

import common
import equinox as eqx
import jax
import numpy as np
from common import A, B, W
from jaxtyping import Float

from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.data.batch import stack_records
from jaxnarx.models import Network, OutputModel
from jaxnarx.regressors import Variables
from jaxnarx.simulation import RunInputs, first_anchor, make_drive, make_masks, run

CHANNELS = Channels(
    common.CHANNELS.inputs, common.CHANNELS.outputs, (Channel("x1"), Channel("x2"))
)
X1, X2 = 4, 5
VARIABLES = ((A, 0), (B, 0), (X1, 1), (X2, 1), (W, 1))
GAIN = np.append(common.GAIN, [2.0, 0.5])
OWN = (2, 3, X1, X2)
"""Signals of y, w, x1, x2: what is computed, in the order of `Network.models`."""

Y_MODELS = (
    [((0, 0), 5.0), ((0, 3), 4.0), ((1, 4), 2.0)],
    [((0, 0), 3.0), ((0, 3), 6.0), ((4, 4), -1.0)],
)
"""Terms in physical units; a row holds places in [1, a, b, x1, x2, w]."""
REST = (
    [((0, 5), 0.4), ((0, 4), 2.0), ((2, 3), 1.0)],
    [((0, 0), 0.2), ((0, 3), 0.7), ((0, 1), 0.2), ((3, 4), -0.1)],
    [((0, 0), -0.1), ((0, 4), 0.5), ((0, 2), 0.9), ((1, 3), 0.1)],
)
CENTRE, WIDTH, OFFSET, SPAN = (0.3, 0.7), (0.2, 0.25), -2.0, 6.0
"""The two local models of y over (x1 - offset) / span."""
LENGTHS = 60, 45
WINDOW = 12
FREE = 1e3
"""A bound, scaled, that nothing reaches."""


def response(kind: str, x, own: float, u) -> Float[np.ndarray, " computed"]:
    """y, w, x1, x2 of one sample; `x` and `own` (w) are those of the sample before."""
    (x1, x2), (a, b) = x, u
    first, second = 5 + 4 * x1 + 2 * a * x2, 3 + 6 * x1 - x2**2
    z = (x1 - OFFSET) / SPAN
    near = [
        np.exp(-0.5 * ((z - c) / s) ** 2) for c, s in zip(CENTRE, WIDTH, strict=True)
    ]
    share = 1.0 if kind == "plain" else near[0] / sum(near)
    return np.array(
        [
            share * first + (1 - share) * second,
            0.4 * own + 2 * x2 + b * x1,
            0.2 + 0.7 * x1 + 0.2 * a - 0.1 * x1 * x2,
            -0.1 + 0.5 * x2 + 0.9 * b + 0.1 * a * x1,
        ]
    )


def loop(
    kind: str, u: Float[np.ndarray, "time 2"], before, top: float = FREE
) -> Float[np.ndarray, "time computed"]:
    """The recursion in plain numbers; `before` is the sample before the first, and x1
    is held at `top`."""
    rows, last = [], np.asarray(before, float)
    for sample in u:
        last = response(kind, last[2:], last[1], sample)
        last[2] = min(last[2], top)
        rows.append(last)
    return np.array(rows)


@dataclasses.dataclass(frozen=True, eq=False)
class Truth:
    """Records without noise with all that was computed, the hidden channels too."""

    data: Dataset
    computed: tuple[Float[np.ndarray, "_ computed"], ...]


@cache
def truth(
    kind: str = "scheduled",
    lengths: tuple[int, ...] = LENGTHS,
    seed: int = 0,
    top: float = FREE,
) -> Truth:
    """Records that begin far from rest."""
    us = [common.signals(n, seed)[:, :2] for n in lengths]
    starts = [[0.0, 1.5 - n, 3.0 - 2 * n, n - 1.0] for n in range(len(us))]
    every = [loop(kind, u, s, top) for u, s in zip(us, starts, strict=True)]
    rows = [np.hstack([u, c[:, :2]]) for u, c in zip(us, every, strict=True)]
    return Truth(common.from_rows(rows), tuple(every))


def part(models, own: int, **more) -> common.Part:
    """Local models of one channel with coefficients for scaled signals."""
    size = np.append(1.0, GAIN[[s for s, _ in VARIABLES]])

    def scaled(row, value):
        return row, float(value * np.prod(size[list(row)]) / GAIN[own])

    return common.Part([[scaled(*term) for term in m] for m in models], **more)


def network(
    kind: str = "scheduled",
    *,
    top: float = FREE,
    window: int = WINDOW,
    told: bool = True,
    **spare: int,
) -> Network:
    """The model as a network; without `told` nothing but x2 depends on x2."""
    where: dict = {}
    if kind == "scheduled":
        where = {"scheduling": ((X1, 1),), "offset": (OFFSET,), "span": (SPAN,)}
        where |= {"centre": [[c] for c in CENTRE], "width": [[s] for s in WIDTH]}
    y = part(Y_MODELS[: 1 + (kind == "scheduled")], OWN[0], **where)
    rest = [part([m], own) for m, own in zip(REST, OWN[1:], strict=True)]
    parts = [y, *rest]
    upper = np.array([FREE, FREE, top / GAIN[X1], FREE])
    low = np.array([-5.0, -1.5, -10.0, -6.0, -2.0, -3.0])
    leaves = GAIN, np.full(4, -FREE), upper, low, -low, np.array(0.1)
    made = [common.output_model(p, **spare) for p in parts]
    if not told:
        made = [_without(m, 4) for m in made[:3]] + made[3:]
    numbers = map(common.device, leaves)
    table = Variables(VARIABLES)
    return Network(CHANNELS, (0, 1), table, tuple(made), *numbers, window=window)


def _without(model: OutputModel, variable: int) -> OutputModel:
    """No term with a variable in use."""
    local = model.local
    there = np.any(np.asarray(local.factor) == variable, axis=1)
    used = np.asarray(local.used) & ~there[np.asarray(local.index)]
    return eqx.tree_at(lambda m: m.local.used, model, jax.device_put(used))


def begun_at(net: Network, given: Truth, row: int = 1) -> RunInputs:
    """Drives with the true hidden values before sample `row` of every record."""
    drive = make_drive(net, stack_records(given.data))
    measured = np.array(drive.measured)
    for n, every in enumerate(given.computed):
        measured[n, row - 1, 2:] = every[row - 1, 2:] / GAIN[[X1, X2]]
    return eqx.tree_at(lambda d: d.measured, drive, jax.device_put(measured))


def free_run(net: Network, given: Truth) -> list[Float[np.ndarray, "_ computed"]]:
    """From the true hidden values before sample 1, in physical units."""
    masks = make_masks(net, stack_records(given.data))
    anchor = jax.device_put(first_anchor(masks))
    y = np.asarray(run(net, begun_at(net, given), anchor)) * GAIN[list(OWN)]
    return [y[n, 1 : len(r)] for n, r in enumerate(given.data)]
