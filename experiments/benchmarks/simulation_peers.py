"""Workers of the simulation benchmark that run in the peers' interpreter.

Each reads what the package has written and prints what it measured as JSON. Only the
standard library is imported here.
"""

import importlib
import importlib.metadata
import importlib.util
from collections.abc import Callable
from typing import Any

from common import best_of
from simulation_data import LIMIT, START, global_terms

PACKAGES = ("numba", "sysidentpy", "fastcan", "numpy")


def installed() -> dict[str, str]:
    """Versions of the peers this interpreter has, numpy's under a name of its own."""
    found = {
        p: importlib.metadata.version(p)
        for p in PACKAGES
        if importlib.util.find_spec(p) is not None
    }
    if (numpy := found.pop("numpy", None)) is not None:
        found["numpy of the peers"] = numpy
    return found


def run_numba(path: str, repeats: int) -> dict[str, Any]:
    """The compiled loop over the collapsed coefficients, with anchors and bound."""
    import numpy as np

    numba = importlib.import_module("numba")
    data = np.load(path)
    g, table = np.ascontiguousarray(data["g"][:, 0]), data["table"]
    measured, anchor = data["measured"][:, 0].copy(), data["anchor"]

    @numba.njit
    def loop(g, table, measured, anchor, limit):
        y = np.empty(len(g))
        x = np.zeros(4)
        x[0] = 1.0
        for t in range(len(g)):
            if anchor[t]:
                for d in range(3):
                    x[1 + d] = measured[t - 1 - d]
            total = 0.0
            for a in range(len(table)):
                total += g[t, a] * x[table[a, 0]] * x[table[a, 1]]
            y[t] = min(max(total, -limit), limit)
            x[3], x[2], x[1] = x[2], x[1], y[t]
        return y

    y = loop(g, table, measured, anchor, LIMIT)
    error = float(np.max(np.abs(y[START:] - data["y"][START:, 0])))
    times = best_of(lambda: loop(g, table, measured, anchor, LIMIT), repeats)
    return {"free_run": times, "largest_difference": error}


def run_sysidentpy(path: str, repeats: int) -> dict[str, Any]:
    """Free run of a polynomial model of eight terms chosen by FROLS."""
    import numpy as np

    structure = importlib.import_module("sysidentpy.model_structure_selection")
    basis = importlib.import_module("sysidentpy.basis_function")
    estimation = importlib.import_module("sysidentpy.parameter_estimation")
    data = np.load(path)
    u, y = data["u"], data["y"]
    model = structure.FROLS(
        basis_function=basis.Polynomial(degree=2),
        ylag=[1, 2, 3],
        xlag=[[1, 2], [1, 2]],
        order_selection=False,
        n_terms=len(global_terms()),
        estimator=estimation.LeastSquares(),
    ).fit(X=u[:1000], y=y[:1000])
    times = best_of(lambda: model.predict(X=u, y=y[:START]), repeats)
    return {"free_run": times}


def run_fastcan(path: str, repeats: int) -> dict[str, Any]:
    """Free run of the polynomial model of `global_terms`."""
    import numpy as np

    narx = importlib.import_module("fastcan.narx")
    data = np.load(path)
    u, y = data["u"], data["y"][:, 0]
    rows = [[*row, *((-1, 0),) * (2 - len(row))] for row in global_terms() if row]
    model = narx.NARX(
        feat_ids=[[s for s, _ in row] for row in rows],
        delay_ids=[[lag if s >= 0 else -1 for s, lag in row] for row in rows],
    ).fit(u[:1000], y[:1000])
    times = best_of(lambda: model.predict(u, y_init=y[:START]), repeats)
    return {"free_run": times}


PEERS: dict[str, Callable[..., dict[str, Any]]] = {
    "numba": run_numba,
    "sysidentpy": run_sysidentpy,
    "fastcan": run_fastcan,
}
