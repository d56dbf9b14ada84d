"""How well any inverse could tell the spark advance from the torque of the `gtdi` bed.

Torque falls with the square of the distance from the best spark: at the best one it
says nothing of the spark, and left and right of it the same. The bound given here has
everything else exactly: at each sample it knows speed, pressure, fuel and mixture, the
noise of the torque sensor and the range from which the spark was drawn, and takes the
mean of all sparks by how well they explain the measured torque (the estimate of least
squared error). What it misses no inverse can tell; what an inverse misses beyond it is
that of its own model of the torque.
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from inverse_bed import DOWN, SPANS

from jaxnarx.engines import Gtdi
from jaxnarx.engines.gtdi import operate

LEVELS = 161
"""Sparks tried over the range of the excitation."""
STRONG = 8.0
"""Distance from the best spark from which on its effect counts as strong [deg]."""


def oracle(u: np.ndarray, seed: int, more: float = 0.0) -> Any:
    """Mean spark by the measured torque, and what is true.

    `u` are the bed's inputs per event. `more` widens the noise of 0.4 Nm by an error of
    the torque model, as root mean square [Nm].
    """
    now = Gtdi().noise["TRQ"].absolute
    spread = np.hypot(now, more)
    q = operate(Gtdi(), jnp.asarray(u))
    true, best = (np.asarray(a)[::DOWN] for a in (q.spark, q.best_spark))
    full = (np.asarray(q.indicated) / efficiency(np.asarray(q.spark - q.best_spark)))[
        ::DOWN
    ]
    schedule = knock_limited(best, np.asarray(q.pressure)[::DOWN])
    low, high = SPANS[1]
    tried = schedule[:, None] + np.linspace(low, high, LEVELS)[None]
    expected = full[:, None] * efficiency(tried - best[:, None])
    noise = np.random.default_rng([seed, 11]).normal(size=len(true)) * spread
    seen = full * efficiency(true - best) + noise
    weight = -0.5 * ((seen[:, None] - expected) / spread) ** 2
    weight = np.exp(weight - weight.max(axis=1, keepdims=True))
    mean = (weight * tried).sum(axis=1) / weight.sum(axis=1)
    return {"best": best, "true": true, "mean": mean, "full": full}


def efficiency(late: np.ndarray) -> np.ndarray:
    """eta_s of `late` degrees from the best spark."""
    c = Gtdi().cylinders
    d = late / 100
    return 1 - float(c.spark_square) * d**2 - float(c.spark_cube) * d**3


def knock_limited(best: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """The schedule about which the spark is excited, at `pressure` [kPa]."""
    slope = float(Gtdi().cylinders.knock_slope)
    return best - slope * np.maximum(pressure / 100 - 1, 0)


def slope(late: np.ndarray, full: np.ndarray) -> np.ndarray:
    """Torque a degree of spark [Nm/deg], without noise."""
    c = Gtdi().cylinders
    d = late / 100
    by = -2 * float(c.spark_square) * d - 3 * float(c.spark_cube) * d**2
    return full * by / 100


def authority_of(found: Mapping[str, np.ndarray], spark: np.ndarray) -> dict[str, Any]:
    """What estimated sparks miss: fit, the same where the effect is strong, and what
    the error costs in torque."""
    true, late = found["true"], found["true"] - found["best"]
    strong = np.abs(late) > STRONG
    cost = found["full"] * (efficiency(spark - found["best"]) - efficiency(late))
    wrong = spark - true
    return {
        "fit": fit(true, spark),
        "fit_strong": fit(true[strong], spark[strong]),
        "rmse": rms(wrong),
        "rmse_strong": rms(wrong[strong]),
        "rmse_weak": rms(wrong[~strong]),
        "torque_rmse": rms(cost),
        "torque_median": float(np.median(np.abs(cost))),
        "share_strong": float(strong.mean()),
    }


def sensitivities(found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Median size of the torque's slope near the best spark and far from it."""
    late = found["true"] - found["best"]
    by = np.abs(slope(late, found["full"]))
    far = np.abs(late) > STRONG
    near = np.abs(late) < 3
    return {"near": float(np.median(by[near])), "far": float(np.median(by[far]))}


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2))) if x.size else float("nan")


def fit(y: np.ndarray, yhat: np.ndarray) -> float:
    """100 (1 - NRMSE)."""
    return 100 * (1 - rms(y - yhat) / float(y.std()))
