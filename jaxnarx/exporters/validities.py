"""Validity functions as operations; one writer for every class of them."""

from collections.abc import Callable

import numpy as np

from jaxnarx.errors import SpecError
from jaxnarx.exporters.form import Builder, Value
from jaxnarx.exporters.parameters import VALIDITIES, OutputAt, has_regions
from jaxnarx.models import (
    LARGEST_ARGUMENT,
    AdditiveGates,
    Boxes,
    Compact,
    GateProducts,
    Gaussians,
    LogSigmoids,
    SigmoidTree,
)

Tables = Callable[[str], np.ndarray]
"""The values of a table of parameters by its kind."""
Weights = tuple[list[Value], Value | None]


def weights(b: Builder, at: OutputAt, z: list[Value], tables: Tables) -> Weights:
    """Numerators of the weights of every active local model at scaled scheduling
    variables `z`, and what the blend is divided by, unless weights sum to one already.
    """
    kind = type(at.model.validity)
    if not has_regions(at):
        return [b.const(1.0)], None
    if kind not in VALIDITIES:
        raise SpecError(
            f"a network with the validity function {kind.__name__} cannot be exported; "
            f"known are {', '.join(k.__name__ for k in VALIDITIES)}",
            field="validity",
        )
    return _VALIDITY_WRITERS[kind](b, at, z, tables)


def _gaussians(b: Builder, at: OutputAt, z, tables: Tables) -> Weights:
    centre, scale = tables("centre"), tables("narrowness")
    half = b.const(-0.5)
    logit = []
    for c, s in zip(centre, scale, strict=True):
        away = [
            b.mul(b.op("sub", x, c_d), s_d) for x, c_d, s_d in zip(z, c, s, strict=True)
        ]
        logit.append(b.mul(half, b.add(*(b.mul(a, a) for a in away))))
    top = b.largest(logit)
    e = [b.op("exp", b.op("sub", one, top)) for one in logit]
    return e, b.add(*e)


def _boxes(b: Builder, at: OutputAt, z, tables: Tables) -> Weights:
    return _nearest(b, z, tables), None


def _nearest(b: Builder, z, tables: Tables) -> list[Value]:
    """One for the box that holds a point, or is nearest to it, zero for the others."""
    low, high = tables("low"), tables("high")
    zero = b.const(0.0)
    away = []
    for l_m, h_m in zip(low, high, strict=True):
        parts = [zero]
        for x, l_d, h_d in zip(z, l_m, h_m, strict=True):
            parts += [b.op("sub", l_d, x), b.op("sub", x, h_d)]
        away.append(b.largest(parts))
    nearest = away[0]
    for one in away[1:]:
        nearest = b.op("min", nearest, one)
    # the last of those equally near
    free, found = b.const(1.0), []
    for one in reversed(away):
        farther = b.op("less", nearest, one)
        found.append(b.op("where", farther, zero, free))
        free = b.op("where", farther, free, zero)
    return found[::-1]


def _compact(b: Builder, at: OutputAt, z, tables: Tables) -> Weights:
    zero, one = b.const(0.0), b.const(1.0)
    z = [b.clip(x, zero, one) for x in z]
    low, high, scale = (tables(what) for what in ("low", "high", "steepness"))
    half = b.const(0.5)

    def smooth(t: Value) -> Value:
        t = b.clip(t, zero, one)
        inner = b.op("sub", b.mul(b.const(6.0), t), b.const(15.0))
        inner = b.add(b.mul(inner, t), b.const(10.0))
        return b.mul(b.mul(b.mul(t, t), t), inner)

    curve = []
    for l_m, h_m, s_m in zip(low, high, scale, strict=True):
        sides = []
        for x, l_d, h_d, s in zip(z, l_m, h_m, s_m, strict=True):
            sides.append(smooth(b.add(b.mul(b.op("sub", x, l_d), s), half)))
            sides.append(smooth(b.add(b.mul(b.op("sub", h_d, x), s), half)))
        curve.append(b.mul(*sides))
    total = b.add(*curve)
    there = b.op("less", b.const(float(np.finfo(np.float64).tiny)), total)
    nearest = _nearest(b, z, tables)
    chosen = [b.op("where", there, c, n) for c, n in zip(curve, nearest, strict=True)]
    return chosen, b.op("where", there, total, one)


def _log_sigmoids(b: Builder, at: OutputAt, z, tables: Tables) -> Weights:
    active, validity = at.active, at.model.validity
    assert isinstance(validity, LogSigmoids)
    border, (steep,) = tables("border"), tables("steepness")
    beyond = {
        int(m) + 1: b.sigmoid(b.mul(steep, b.op("sub", z[0], x)))
        for m, x in zip(active[active > 0] - 1, border, strict=True)
    }
    zero, one = b.const(0.0), b.const(1.0)
    count = len(np.asarray(validity.border)) + 1
    steps = [one, *(beyond.get(m, zero) for m in range(1, count)), zero]
    return [b.op("sub", steps[m], steps[m + 1]) for m in active.tolist()], None


def _sigmoid_tree(b: Builder, at: OutputAt, z, tables: Tables) -> Weights:
    validity = at.model.validity
    assert isinstance(validity, SigmoidTree)
    path = np.asarray(validity.path)[at.active]
    gates = np.flatnonzero(np.any(path != 0, axis=0))
    direction, border = tables("gate"), tables("gate_border")
    one = b.const(1.0)
    least, most = b.const(-LARGEST_ARGUMENT), b.const(LARGEST_ARGUMENT)
    sides = {}
    for n, g in enumerate(gates.tolist()):
        a = b.clip(b.op("sub", b.dot(direction[n], z), border[n]), least, most)
        e = b.op("exp", b.op("neg", a))
        above = b.op("div", one, b.add(one, e))
        sides[g] = above, b.mul(e, above)
    products = [
        b.mul(*(sides[g][int(row[g] < 0)] for g in gates.tolist() if row[g]))
        for row in path
    ]
    return products, None


def _additive_gates(b: Builder, at: OutputAt, z, tables: Tables) -> Weights:
    one = b.const(1.0)
    least, most = b.const(-LARGEST_ARGUMENT), b.const(LARGEST_ARGUMENT)
    found = [one] if at.active[0] == 0 else []
    for direction, border in zip(tables("gate"), tables("gate_border"), strict=True):
        a = b.clip(b.op("sub", b.dot(direction, z), border), least, most)
        found.append(b.sigmoid(a))
    return found, None


_VALIDITY_WRITERS: dict[type, Callable[..., Weights]] = {
    Gaussians: _gaussians,
    Boxes: _boxes,
    Compact: _compact,
    LogSigmoids: _log_sigmoids,
    SigmoidTree: _sigmoid_tree,
    AdditiveGates: _additive_gates,
    GateProducts: _sigmoid_tree,
}
