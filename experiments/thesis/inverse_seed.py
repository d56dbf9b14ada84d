"""One seed of `chapter7_inverse.py`: identify, compensate, and drive the bed."""

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from inverse_bed import COMMANDS, TARGETS, asked, recorded
from inverse_bench import Track, bench, case
from inverse_models import (
    FORCED,
    forward_of,
    inverse_of,
    judged,
    throttle_alone,
    turned,
)
from inverse_spark import authority_of, oracle, sensitivities

import jaxnarx as jnx
from jaxnarx.engines import Gtdi

PARTS = ("one", "two", "three", "four", "validation", "test")
TRAIN, GUARD, TEST = slice(0, 4), 4, 5
LIMITS = jnx.inverse.ActuatorLimits(
    range={"SA": (-12.0, 32.0), "THR": (12.0, 28.0)}, rate={"SA": 200.0, "THR": 200.0}
)
CLOSED = (0.03, 0.3, 1.0)
"""Time constants of the closed loops [s] from which validation chooses."""
REST = 250
"""Samples in which a cascade comes to rest."""
MISMATCH, RELATIVES = 0.1, 1
"""Spread of the engine's parameters, and how many such engines a seed has."""


@dataclasses.dataclass(frozen=True)
class Size:
    """What one seed may cost."""

    length: int = 1200
    """Samples of a record."""
    steps: int = 8
    """Of the training on the tracking error."""
    trained: int = 2
    """Records it is trained on."""
    relatives: int = RELATIVES
    points: int = 20
    brief: bool = False
    """Small models, not refined by themselves."""


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """All that a seed has made, for figures."""

    data: jnx.Dataset
    references: jnx.Dataset
    forward: jnx.Network
    grown: jnx.Network
    direct: jnx.Network
    refined: jnx.Network
    tracks: dict[str, Track]
    spark: dict[str, np.ndarray]
    history: int


def seed_of(seed: int, size: Size) -> tuple[dict[str, Any], Case]:
    """The row of a seed, and what its figures need."""
    begin = time.perf_counter()
    data, u, clean = recorded(seed, size.length, PARTS)
    train, guard, test = data[TRAIN], data[GUARD : GUARD + 1], data[TEST : TEST + 1]
    forward = forward_of(train, guard, brief=size.brief)
    grown, direct = inverse_of(train, guard, brief=size.brief)
    airy = inverse_of(train, guard, FORCED, brief=size.brief)[1]
    row: dict[str, Any] = {
        "forward": {"validation": judged(forward, guard), "test": judged(forward, test)}
    }
    row["inverse"] = {
        name: {
            part: judged(net, turned(one))
            for part, one in (("validation", guard), ("test", test))
        }
        for name, net in (("grown", grown), ("direct", direct), ("air terms", airy))
    }
    print(seed, "identified", round(time.perf_counter() - begin), "s", flush=True)
    row["spark"], spark = spark_of(seed, direct, test, u[TEST])
    own = reachable_of(forward, train[: size.trained]), reachable_of(forward, guard)
    solution = jnx.inverse.compensate(
        *(airy, forward, own[0]),
        jnx.inverse.TrackingError(max_steps=size.steps, effort=1e-4),
        validation=own[1],
        trainable=throttle_alone(airy),
        limits=LIMITS,
    )
    refined = solution.value
    row["compensate"] = {
        "status": solution.status_name,
        "start": solution.stats["loss_start"],
        "end": solution.stats["loss"],
        "history": [h["validation"] for h in solution.stats["history"]],
    }
    print(seed, "compensated", round(time.perf_counter() - begin), "s", flush=True)
    row["invertible"] = standing_of(forward, guard)
    inverses = {"direct": direct, "air terms": airy, "refined": refined}
    row["on_model"] = {
        name: dict(
            zip(
                TARGETS, tracked(net, forward, reachable_of(forward, test)), strict=True
            )
        )
        for name, net in inverses.items()
    }
    row["unity"] = {
        name: unity_of(net, forward, guard, size.points)
        for name, net in inverses.items()
    }
    rest = resting(forward, guard, 2 * size.points)
    row["at_rest"] = {n: rest_of(net, forward, rest) for n, net in inverses.items()}
    print(seed, "judged on the model", round(time.perf_counter() - begin), "s")
    asked_for = asked(data, clean)
    benches = Benches(seed, inverses, forward, asked_for, u, mean_of(train))
    row["closed"], tracks = benches.nominal(row, size.brief)
    benches.mismatched(row, size.relatives)
    row["seconds"] = round(time.perf_counter() - begin)
    history = max(forward.history, direct.history)
    made = Case(
        *(data, asked_for, forward, grown, direct, refined, tracks, spark, history)
    )
    return row, made


def reachable_of(forward: jnx.Network, data: jnx.Dataset) -> jnx.Dataset:
    """References that the model reaches: what it does under the recorded commands.

    With the bed's own outputs the inverse would be trained to make good the model's
    error, which is not there on the bed.
    """
    return asked(data, jnx.simulate(forward, data).value.outputs)


def standing_of(forward: jnx.Network, data: jnx.Dataset) -> list[dict[str, str]]:
    """What `invertible` finds against an inverse in the forward network."""
    found = jnx.inverse.invertible(forward, data, commands=COMMANDS, targets=TARGETS)
    return [
        {"severity": f.severity, "kind": f.kind, "message": f.message}
        for f in found.value.findings
    ]


def tracked(inverse, forward, references) -> list[float]:
    found = jnx.inverse.cascade(inverse, forward, references, LIMITS).value.nrmse()
    return [float(e) for e in found]


def unity_of(inverse, forward, data, points: int) -> dict[str, Any]:
    """How far the static gain of the cascade is from one."""
    found = jnx.inverse.unity_gain(inverse, forward, data, points=points, limits=LIMITS)
    value = found.value
    good = value.settled & ~value.held
    away = np.abs(value.gain[good] - np.eye(2)[None])
    own = np.array([away[:, i, i] for i in range(2)])
    return {
        "status": found.status_name,
        "good": float(good.mean()),
        "held": float(value.held.mean()),
        "worst": {
            n: float(a.max(initial=0)) for n, a in zip(TARGETS, own, strict=True)
        },
        "median": {
            n: float(np.median(a)) if a.size else None
            for n, a in zip(TARGETS, own, strict=True)
        },
        "within_5_percent": {
            n: float(np.mean(a < 0.05)) if a.size else None
            for n, a in zip(TARGETS, own, strict=True)
        },
    }


def resting(forward: jnx.Network, data: jnx.Dataset, points: int) -> jnx.Dataset:
    """References at rest that the model holds under recorded inputs, a record each.

    Fuel and speed belong to the reference here; `unity_of` moves one reference at a
    time under a fuel that stays.
    """
    (record,) = data
    at = np.linspace(0, len(record) - 1, points).astype(int)
    held = jnx.Dataset.from_arrays(
        [np.tile(record.u[t], (REST, 1)) for t in at],
        [np.tile(record.y[t], (REST, 1)) for t in at],
        inputs=list(data.channels.inputs),
        outputs=list(data.channels.outputs),
        sample_time=data.sample_time,
    )
    found = jnx.simulate(forward, held).value
    ends = [np.tile(y[-1], (REST, 1)) for y in found.outputs]
    still = [
        np.all(np.abs(y[-1] - y[-REST // 4]) < 1e-3 * np.abs(y[-1])) and not m[-1].any()
        for y, m in zip(found.outputs, found.limited, strict=True)
    ]
    everything = asked(held, ends)
    return everything[[n for n, good in enumerate(still) if good]]


def rest_of(inverse, forward, references: jnx.Dataset) -> dict[str, Any]:
    """Where the cascade comes to rest: slope over the references, and errors left."""
    if len(references) < 3:
        return {"points": len(references)}
    found = jnx.inverse.cascade(inverse, forward, references, LIMITS).value
    wanted = np.array([r[-1] for r in found.references])
    reached = np.array([y[-1, list(found.targets)] for y in found.outputs])
    slope = [np.polyfit(*pair, 1)[0] for pair in zip(wanted.T, reached.T, strict=True)]
    left = np.sqrt(np.mean((reached - wanted) ** 2, axis=0)) / wanted.std(axis=0)
    return {
        "points": len(wanted),
        "slope": {n: float(f"{g:.5g}") for n, g in zip(TARGETS, slope, strict=True)},
        "nrmse": {n: float(f"{e:.5g}") for n, e in zip(TARGETS, left, strict=True)},
    }


def spark_of(seed: int, direct: jnx.Network, test: jnx.Dataset, u: np.ndarray):
    """The bound of any inverse, and what ours misses beside it."""
    bound = oracle(u, seed)
    estimated = jnx.simulate(direct, turned(test)).value.outputs[0][:, 0]
    short = {k: v[: len(estimated)] for k, v in bound.items()}
    ours = authority_of(short, estimated)
    model = oracle(u, seed, more=ours["torque_rmse"])
    found = {
        "sensitivity": sensitivities(bound),
        "bound": authority_of(bound, bound["mean"]),
        "bound_with_our_torque_error": authority_of(model, model["mean"]),
        "ours": ours,
    }
    return found, short | {"estimated": estimated}


def mean_of(train: jnx.Dataset) -> np.ndarray:
    """Constant commands: their means."""
    at = [train.channels.signal(name) for name in COMMANDS]
    return np.concatenate([r.u for r in train])[:, at].mean(axis=0)


class Benches:
    """The bed behind each inverse, on validation and on unseen references."""

    def __init__(
        self,
        seed: int,
        inverses: dict[str, jnx.Network],
        forward: jnx.Network,
        references: jnx.Dataset,
        inputs: Sequence[np.ndarray],
        mean: np.ndarray,
    ):
        self.seed, self.mean = seed, mean
        self.parts = inverses, forward, references, inputs

    def run(self, name: str, cases: list, part: int, engine: Any = None) -> list[Track]:
        inverses, forward, references, inputs = self.parts
        one = references[part : part + 1]
        made = bench(
            *(inverses[name], forward, LIMITS),
            *(Gtdi() if engine is None else engine, inputs[part], one),
            self.seed * 10 + part,
        )
        return made.run(cases)

    def errors(self, track: Track, part: int) -> dict[str, float]:
        inverses, forward, references, _ = self.parts
        first = max(forward.history, inverses["direct"].history)
        y = references.records[part].y[first:, :2]
        left = track.outputs[first:, :2] - y
        nrmse = np.sqrt((left**2).mean(axis=0)) / y.std(axis=0)
        return {n: float(f"{e:.5g}") for n, e in zip(TARGETS, nrmse, strict=True)}

    def closed(self, name: str, forward: bool, brief: bool) -> float:
        """The best time constant on the validation record."""
        if brief:
            return CLOSED[1]
        cases = [case(self.mean, forward, closed) for closed in CLOSED]
        runs = [self.errors(t, GUARD) for t in self.run(name, cases, GUARD)]
        score = [sum(e**2 for e in run.values()) for run in runs]
        return CLOSED[int(np.nanargmin(score))]

    def cases(self, chosen: dict[str, float]) -> dict[str, list[tuple[str, Any]]]:
        """By inverse: what is run, by name."""
        mean = self.mean
        return {
            "direct": [("direct", case(mean, True))],
            "air terms": [("air terms", case(mean, True))],
            "refined": [
                ("constant", case(mean, False)),
                ("PI", case(mean, False, chosen["PI"])),
                ("refined", case(mean, True)),
                ("refined + PI", case(mean, True, chosen["refined"])),
            ],
        }

    def all(self, chosen: dict[str, float], engine: Any = None) -> dict[str, Track]:
        found = {}
        for name, named in self.cases(chosen).items():
            tracks = self.run(name, [c for _, c in named], TEST, engine)
            found |= dict(zip([n for n, _ in named], tracks, strict=True))
        return found

    def nominal(
        self, row: dict[str, Any], brief: bool
    ) -> tuple[dict[str, float], dict[str, Track]]:
        """Choose the PI's speed by validation, then run unseen references."""
        chosen = {"PI": self.closed("refined", False, brief)}
        chosen["refined"] = self.closed("refined", True, brief)
        self.chosen, tracks = chosen, self.all(chosen)
        row["bed"] = {n: self.scored(t) for n, t in tracks.items()}
        return chosen, tracks

    def mismatched(self, row: dict[str, Any], count: int) -> None:
        """The same with engines whose parameters have moved."""
        row["mismatch"] = []
        for i in range(count):
            key = jax.random.fold_in(jax.random.key(1000 + self.seed), i)
            engine = Gtdi().perturb(key, MISMATCH)
            tracks = self.all(self.chosen, engine)
            row["mismatch"].append({n: self.scored(t) for n, t in tracks.items()})

    def scored(self, track: Track) -> dict[str, float]:
        """Tracking, and how much of the fuel the PI trims."""
        trim = float(np.sqrt(np.mean(track.commands[:, 2] ** 2)))
        return self.errors(track, TEST) | {"trim": round(trim, 5)}
