"""Verdicts on thirty models whose quality is known.

Five simulated plants, noise of 2 %; the model is right or spoilt in one known way:
overfitted, diverging, made without an input that matters, with lags that miss the dead
time, met by one record of another plant, or used outside of what it was trained on. The
truth is the plant itself: a model is good where its free run over fresh noise-free
records like those of the test explains 90 % of the variance in every one of them; one
that is used outside of what it was trained on is not, whatever its luck.

A verdict is right where it is "good" for a good model and else one of the two others,
"not usable" where a record diverges.

    python experiments/verdict/run.py [--smoke]

Results: `experiments/benchmarks/results/verdict.json`.
"""

import argparse
import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
from common import record, results_folder  # noqa: E402 # pyright: ignore

NOISE, LENGTH, DEAD = 0.02, 500, 4
GOOD = 0.1**0.5
"""NRMSE that leaves a tenth of the variance."""

Plant = Callable[[np.ndarray], np.ndarray]


def response(u: np.ndarray, static: Callable, pole: float, dead: int) -> np.ndarray:
    """A static function of two inputs behind a dead time and two lags."""
    x = np.concatenate([np.tile(u[:1], (dead, 1)), u])[: len(u)]
    drive = static(x[:, 0], x[:, 1])
    y = np.zeros(len(u))
    slow = 0.0
    for t in range(1, len(u)):
        slow = pole * slow + (1 - pole) * drive[t - 1]
        y[t] = 0.5 * y[t - 1] + 0.5 * slow
    return y


PLANTS: dict[str, Plant] = {
    "linear": lambda u: response(u, lambda a, b: a + 0.8 * b, 0.8, 0),
    "bilinear": lambda u: response(u, lambda a, b: a * (1 + b) + 0.5 * b, 0.7, 0),
    "saturating": lambda u: response(
        u, lambda a, b: np.tanh(1.5 * a) + 0.7 * b, 0.8, 0
    ),
    "parabola": lambda u: response(u, lambda a, b: a + a**2 - b, 0.85, 0),
    "ridge": lambda u: response(
        u, lambda a, b: 1.5 * np.exp(-4 * (a - 0.3) ** 2) + b, 0.6, 0
    ),
}
DELAYED: dict[str, Plant] = {
    name: lambda u, f=f: f(np.concatenate([np.tile(u[:1], (DEAD, 1)), u])[: len(u)])
    for name, f in PLANTS.items()
}


def inputs(seed: int, reach: float = 1.0, hold: int = 25) -> np.ndarray:
    """Steps of two inputs."""
    rng = np.random.default_rng(seed)
    columns = []
    for _ in range(2):
        holds = rng.integers(3, hold, LENGTH)
        columns.append(np.repeat(rng.uniform(-reach, reach, LENGTH), holds)[:LENGTH])
    return np.stack(columns, axis=1)


def records(plant: Plant, seeds: range, *, reach=1.0, noise=NOISE, hold=25) -> Any:
    """One for every seed."""
    import jaxnarx as jnx

    us = [inputs(seed, reach, hold) for seed in seeds]
    ys = [plant(u)[:, None] for u in us]
    spread = noise * np.concatenate(ys).std()
    rng = np.random.default_rng(seeds.start)
    return jnx.Dataset.from_arrays(
        us,
        [y + spread * rng.normal(size=y.shape) for y in ys],
        inputs=["a", "b"],
        outputs=["y"],
        sample_time=0.1,
        names=[f"r{seed}" for seed in seeds],
    )


@dataclasses.dataclass(frozen=True)
class Known:
    """A model, its records, and fresh ones that tell the truth."""

    kind: str
    plant: str
    network: Any
    train: Any
    test: Any
    truth: Any


def searched(train: Any) -> Any:
    """What `identify` finds quickly."""
    import jaxnarx as jnx

    return jnx.identify(train, preset="quick", candidates=14).value


def by_hand(train: Any, *, lags=(1, 2), outputs=(1, 2), degree=2, terms=12) -> Any:
    """One polynomial by forward selection, one step ahead."""
    import jaxnarx as jnx

    pool = jnx.polynomial_pool(
        train.channels, input_lags=lags, output_lags=outputs, degree=degree
    )
    chosen = jnx.select(pool, train, jnx.ForwardOLS(max_terms=terms)).value
    return jnx.grow(chosen, train, jnx.Global()).value


def good(name: str, seed: int) -> Known:
    """Enough records, a search."""
    plant = PLANTS[name]
    train = records(plant, range(seed, seed + 4))
    test = records(plant, range(seed + 50, seed + 53))
    fresh = records(plant, range(seed + 70, seed + 73), noise=0.0)
    return Known("good", name, searched(train), train, test, fresh)


def overfitted(name: str, seed: int) -> Known:
    """Sixty cubic terms on sixty samples."""
    one = dataclasses.replace(good_data(name, seed), kind="overfitted")
    short = cut(one.train[:1], 90)
    net = by_hand(short, lags=(0, 1, 2, 3), outputs=(1, 2, 3), degree=3, terms=60)
    return dataclasses.replace(one, network=net, train=short)


def diverging(name: str, seed: int) -> Known:
    """A cubic of the output's past that leaves its bounds where inputs reach twice as
    far."""
    import equinox as eqx

    one = dataclasses.replace(good_data(name, seed), kind="diverging")
    net = by_hand(one.train, degree=1, terms=6)
    grown = [1.35 * m.local.coefficient for m in net.models]
    net = eqx.tree_at(lambda n: [m.local.coefficient for m in n.models], net, grown)
    return dataclasses.replace(one, network=net)


def without(name: str, seed: int) -> Known:
    """The second input is held at its mean in training and not told of."""
    one = dataclasses.replace(good_data(name, seed), kind="input left out")
    import jaxnarx as jnx

    pool = jnx.polynomial_pool(
        one.train.channels,
        input_lags={"a": (1, 2), "b": ()},
        output_lags=(1, 2),
        degree=2,
    )
    chosen = jnx.select(pool, one.train, jnx.ForwardOLS(max_terms=10)).value
    net = jnx.grow(chosen, one.train, jnx.Global()).value
    return dataclasses.replace(one, network=net)


def late(name: str, seed: int) -> Known:
    """Lags that end before the dead time."""
    data = good_data(name, seed, DELAYED[name], hold=6)
    net = by_hand(data.train, lags=(0, 1), outputs=(1,), degree=2, terms=8)
    return dataclasses.replace(data, network=net, kind="dead time missed")


def one_bad(name: str, seed: int) -> Known:
    """Good, and one test record is of another plant."""
    import jaxnarx as jnx

    one = dataclasses.replace(good(name, seed), kind="one bad record")
    other = dict(zip(PLANTS, [*list(PLANTS)[1:], "linear"], strict=True))[name]

    def spoilt(u: np.ndarray) -> np.ndarray:
        return 1.2 - PLANTS[other](u)

    def joined(data: Any, seed: int, noise: float) -> Any:
        bad = records(spoilt, range(seed, seed + 1), noise=noise)
        return jnx.data.join([data, bad])

    return dataclasses.replace(
        one,
        test=joined(one.test, seed + 90, NOISE),
        truth=joined(one.truth, seed + 95, 0.0),
    )


def outside(name: str, seed: int) -> Known:
    """Trained on a quarter of the ranges that it is used on."""
    plant = PLANTS[name]
    train = records(plant, range(seed, seed + 4), reach=0.25)
    test = records(plant, range(seed + 50, seed + 53))
    fresh = records(plant, range(seed + 70, seed + 73), noise=0.0)
    return Known(outside.__name__, name, searched(train), train, test, fresh)


def good_data(name: str, seed: int, plant: Plant | None = None, hold=25) -> Known:
    """Records without a model."""
    plant = PLANTS[name] if plant is None else plant
    train = records(plant, range(seed, seed + 4), hold=hold)
    test = records(plant, range(seed + 50, seed + 53), hold=hold)
    fresh = records(plant, range(seed + 70, seed + 73), noise=0.0, hold=hold)
    return Known("", name, None, train, test, fresh)


def cut(data: Any, rows: int) -> Any:
    """The first samples of every record."""
    short = tuple(
        dataclasses.replace(r, u=r.u[:rows], y=r.y[:rows], valid=r.valid[:rows])
        for r in data.records
    )
    return dataclasses.replace(data, records=short)


NONLINEAR = ("bilinear", "saturating", "parabola", "ridge")
CASES: tuple[tuple[Callable[[str, int], Known], tuple[str, ...]], ...] = (
    (good, (*PLANTS, *NONLINEAR)),
    (overfitted, NONLINEAR),
    (diverging, NONLINEAR[:3]),
    (without, (*NONLINEAR[:3], "linear")),
    (late, NONLINEAR[:3]),
    (one_bad, NONLINEAR[:3]),
    (outside, NONLINEAR),
)


def judged(case: Known) -> dict[str, Any]:
    """The verdict beside the truth."""
    import jaxnarx as jnx

    report = jnx.report(case.network, {"train": case.train, "test": case.test})
    run = jnx.simulate(case.network, case.truth).value
    errors = [
        float(np.sqrt(np.mean((r.y[20:, 0] - y[20:, 0]) ** 2)) / r.y[:, 0].std())
        for r, y in zip(case.truth, run.outputs, strict=True)
    ]
    # a record of the test that diverges is a fact as well
    tested = jnx.simulate(case.network, case.test).value
    diverged = any(bool(d.any()) for d in (*run.diverged, *tested.diverged))
    small = max(errors) < GOOD and not diverged
    is_good = small and case.kind != outside.__name__
    level = report.verdict.level
    right = (level == "good") == is_good and (not diverged or level == "not usable")
    return {
        "made": case.kind,
        "plant": case.plant,
        "truth, NRMSE by record": [round(e, 4) for e in errors],
        "diverged": diverged,
        "is good": is_good,
        "error is small": small,
        "verdict": level,
        "right": right,
        "sentence": report.verdict.sentence,
    }


def main() -> None:
    """All of them."""
    import jax

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="three models")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows = []
    for make, names in CASES:
        if options.smoke and make not in (overfitted, diverging, without):
            continue
        for n, name in enumerate(names[:1] if options.smoke else names):
            rows.append(judged(make(name, 1000 * (len(rows) + 1) + 100 * n)))
            print(rows[-1], flush=True)
    wrong_good = sum(r["verdict"] == "good" and not r["is good"] for r in rows)
    figures = {
        "models": len(rows),
        "right": sum(r["right"] for r in rows),
        "good for a bad one": wrong_good,
        "rows": rows,
    }
    print({k: v for k, v in figures.items() if k != "rows"})
    folder = results_folder(options.results, smoke=options.smoke)
    record("verdict", figures, folder=folder)


if __name__ == "__main__":
    main()
