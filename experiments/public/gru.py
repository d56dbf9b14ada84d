"""A gated recurrent unit in plain jax, trained by Adam on windows of the records.

It sees the inputs alone and is zero in the beginning; the first `WASHOUT` samples of a
window are not counted. The last quarter of every training record stops the training:
the parameters with the smallest error there are kept. Three seeds, each with a limit of
time; float32. K. Cho et al., Learning phrase representations using RNN encoder-decoder
for statistical machine translation, EMNLP 2014.
"""

import time
from typing import Any

from packed import Runs, Task, unpack  # pyright: ignore
from peers import divided, gently, judged  # pyright: ignore
from score import digits  # pyright: ignore

UNITS = {
    "cascaded_tanks": 16,
    "ced_coupled_drives": 16,
    "bouc_wen_sysidentpy": 32,
    "daisy_cstr": 32,
    "silverbox": 64,
    "wiener_hammerstein": 64,
}
"""About the published sizes."""

SEEDS = (0, 1, 2)
SECONDS = 90.0
"""For a seed."""
WASHOUT, WINDOW, BATCH = 50, 250, 32
RATE, LAST, STEPS = 5e-3, 5e-4, 8000
"""Rate of Adam, falling by a cosine to the last one over so many steps."""
LOOK, PATIENCE = 50, 30
"""Steps between looks at the validation; looks without an improvement to the end."""
STRETCH = 1000
"""Samples of a stretch of the validation, behind a washout."""


def fit_gru(name: str, path: str, output: str, small: bool) -> dict[str, Any]:
    """Train with every seed and score; the mean of the errors is in `test`."""
    import numpy as np

    gently()
    task, begin = unpack(path, output), time.perf_counter()
    scaled = Scaled(task)
    units, seeds = (4, SEEDS[:1]) if small else (UNITS[name], SEEDS)
    tests, lowest, steps = [], [], []
    for seed in seeds:
        params, error, count = train(scaled, units, seed, 1.0 if small else SECONDS)
        tests.append(judged(task, lambda part, p=params: scaled.runs(p, part)))
        lowest.append(digits(error))
        steps.append(count)
    test = {}
    for part in task.parts:
        own = [one[part] for one in tests]
        test[part] = own[0] | {
            key: digits(float(np.mean([one[key] for one in own])))
            for key in ("rmse", "nrmse")
        }
        test[part]["seeds"] = [one["rmse"] for one in own]
    inputs = task.train.u[0].shape[1]
    return {
        "test": test,
        "held_back_nrmse": lowest,
        "units": units,
        "steps": steps,
        "parameters": sum(p.size for p in start(inputs, units, 0).values()),
        "operations": operations(inputs, units),
        "fit_seconds": round(time.perf_counter() - begin, 1),
    }


def operations(inputs: int, units: int) -> int:
    """Multiplications, divisions and exponentials at a sample: three gates, their
    curves, the mixing, and what comes out."""
    return 3 * units * (inputs + units) + 9 * units + units + inputs


def start(inputs: int, units: int, seed: int) -> dict[str, Any]:
    """Parameters to begin with."""
    import numpy as np

    random = np.random.default_rng(seed)

    def normal(rows: int, columns: int) -> Any:
        values = random.normal(size=(rows, columns)) / np.sqrt(rows)
        return values.astype(np.float32)

    return {
        "from input": normal(inputs, 3 * units),
        "from state": normal(units, 3 * units),
        "offset": np.zeros(3 * units, np.float32),
        "state out": normal(units, 1)[:, 0],
        "input out": normal(inputs, 1)[:, 0],
        "out": np.zeros(1, np.float32),
    }


def run(params: dict[str, Any], u: Any) -> Any:
    """Outputs (time, batch) from inputs (time, batch, inputs)."""
    import jax
    import jax.numpy as jnp

    units = params["state out"].size
    driven = u @ params["from input"] + params["offset"][None, None]

    def step(h: Any, x: Any) -> tuple[Any, Any]:
        back = h @ params["from state"]
        gates = jax.nn.sigmoid(x[:, : 2 * units] + back[:, : 2 * units])
        z, r = jnp.split(gates, 2, axis=1)
        new = jnp.tanh(x[:, 2 * units :] + r * back[:, 2 * units :])
        h = z * h + (1 - z) * new
        return h, h @ params["state out"]

    begin = jnp.zeros((u.shape[1], units), u.dtype)
    out = jax.lax.scan(step, begin, driven)[1] + u @ params["input out"]
    return out + params["out"][None]


class Scaled:
    """Signals of a task by their mean and standard deviation in the training."""

    def __init__(self, task: Task):
        import numpy as np

        self.task = task
        u, y = np.concatenate(task.train.u), np.concatenate(task.train.y)
        self.u = u.mean(axis=0), np.maximum(u.std(axis=0), 1e-12)
        self.y = float(y.mean()), float(y.std())

    def inputs(self, u: Any) -> Any:
        """Scaled inputs."""
        return ((u - self.u[0][None]) / self.u[1][None]).astype("float32")

    def outputs(self, y: Any) -> Any:
        """Scaled outputs."""
        return ((y - self.y[0]) / self.y[1]).astype("float32")

    def runs(self, params: Any, part: Runs) -> list[Any]:
        """Runs of the records in their own unit."""
        import jax
        import numpy as np

        model = jax.jit(run)
        return [
            self.y[0]
            + self.y[1] * np.asarray(model(params, self.inputs(u)[:, None])[:, 0])
            for u in part.u
        ]


def train(
    scaled: Scaled, units: int, seed: int, limit: float
) -> tuple[dict[str, Any], float, int]:
    """Parameters with the smallest error on what is held back, that error (NRMSE) and
    the steps taken."""
    import jax
    import jax.numpy as jnp
    import numpy as np
    import optax

    head, _ = divided(scaled.task.train)
    random = np.random.default_rng(seed)
    params = start(head.u[0].shape[1], units, seed)
    method = optax.chain(
        optax.clip_by_global_norm(1.0),
        optax.adam(optax.cosine_decay_schedule(RATE, STEPS, LAST / RATE)),
    )
    state = method.init(params)

    def loss(params: Any, u: Any, y: Any) -> Any:
        return jnp.mean((run(params, u) - y)[WASHOUT:] ** 2)

    @jax.jit
    def step(params: Any, state: Any, u: Any, y: Any) -> tuple[Any, Any]:
        change, state = method.update(jax.grad(loss)(params, u, y), state, params)
        return optax.apply_updates(params, change), state

    validation, judge = _validation(scaled), jax.jit(loss)
    best, kept, since, count = np.inf, params, 0, 0
    begin = time.perf_counter()
    while count < STEPS and since < PATIENCE and time.perf_counter() - begin < limit:
        for _ in range(LOOK):
            params, state = step(params, state, *_windows(scaled, head, random))
        count, since = count + LOOK, since + 1
        error = float(judge(params, *validation))
        if error < best:
            best, kept, since = error, params, 0
    return kept, best**0.5, count


def _windows(scaled: Scaled, head: Runs, random: Any) -> tuple[Any, Any]:
    """Windows at random of all records, (time, batch, inputs) and (time, batch)."""
    import numpy as np

    lengths = np.array([len(y) for y in head.y])
    window = min(WINDOW, int(lengths.min()))
    which = random.choice(len(lengths), BATCH, p=lengths / lengths.sum())
    u, y = [], []
    for n in which:
        first = random.integers(0, lengths[n] - window + 1)
        u.append(head.u[n][first : first + window])
        y.append(head.y[n][first : first + window])
    return scaled.inputs(np.stack(u, axis=1)), scaled.outputs(np.stack(y, axis=1))


def _validation(scaled: Scaled) -> tuple[Any, Any]:
    """Stretches of the end of every record, with a washout before each."""
    import numpy as np

    train = scaled.task.train
    length = WASHOUT + min(
        STRETCH, *(len(y) - int(0.75 * len(y)) for y in train.y), STRETCH
    )
    u, y = [], []
    for own, out in zip(train.u, train.y, strict=True):
        last = len(out) - length
        for first in range(int(0.75 * len(out)) - WASHOUT, last + 1, length - WASHOUT):
            u.append(own[first : first + length])
            y.append(out[first : first + length])
    return scaled.inputs(np.stack(u, axis=1)), scaled.outputs(np.stack(y, axis=1))
