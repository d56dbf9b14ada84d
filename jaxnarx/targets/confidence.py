"""What a model knows of its own trust as operations: index of the domain, intervals."""

import numpy as np

from jaxnarx.models import FARTHEST, GROWTH, Domain, ErrorModel
from jaxnarx.targets.form import Builder, Value


def domain_index(
    b: Builder, domain: Domain, x: list[Value], step: list[Value]
) -> Value:
    """The index of a sample, one at the border (`Domain.layers`); `x` are the features
    and `step` the inputs' steps from the sample before, physical units."""
    used = len(domain.inputs)
    border = np.asarray(domain.border, float)
    middle, half, rate = (np.asarray(a, float) for a in domain.widths)
    alone = [
        b.size(b.op("sub", x[k], b.const(middle[k])), 1 / (half[k] * border[0]))
        for k in range(used)
    ]
    fast = [b.size(one, 1 / (rate[k] * border[1])) for k, one in enumerate(step)]
    center, spread = (
        np.asarray(a, float).tolist() for a in (domain.middle, domain.spread)
    )
    unit = [
        b.mul(b.op("sub", value, b.const(m)), b.const(1 / s))
        for value, m, s in zip(x, center, spread, strict=True)
    ]
    whiten = b.parameters(
        "domain_ellipsoid",
        np.asarray(domain.whiten, float) / border[2],
        "rows that make features of unit size uncorrelated, one at the border",
    )
    joint = b.add(*(b.square(b.dot(row, unit)) for row in whiten))
    points = b.parameters(
        "domain_points",
        np.asarray(domain.points, float) / border[3],
        "a row for every stored point of the training, weighted features, one at the "
        "border",
    )
    weight = np.asarray(domain.weight, float) / border[3]
    seen = [b.mul(u, b.const(w)) for u, w in zip(unit, weight.tolist(), strict=True)]
    apart = [
        b.add(*(b.square(b.op("sub", u, p)) for u, p in zip(seen, row, strict=True)))
        for row in points
    ]
    near = apart[0]
    for one in apart[1:]:
        near = b.op("min", near, one)
    far = b.op("sqrt", b.op("max", joint, near))
    return b.op("min", b.largest([far, *alone, *fast]), b.const(FARTHEST))


def half_width(
    b: Builder, errors: ErrorModel, output: int, level: float, z: list[Value], name: str
) -> Value:
    """Half of the prediction interval of an output, in its unit; the last of the
    variables `z` is the index (`jaxnarx.models.error_model`)."""
    knots = np.asarray(errors.knots[output], float)
    height = np.asarray(errors.height[output], float)
    slope = np.diff(height, axis=1) / np.diff(knots, axis=1)
    slopes = b.parameters(
        f"doubt_{name}",
        slope,
        "slopes of the logarithm of the error between knots, a row for every variable",
    )
    zero = b.const(0.0)
    total = [b.const(float(errors.constant[output]) + float(height[:, 0].sum()))]
    for at, row, value in zip(knots.tolist(), slopes, z, strict=True):
        for low, high, s in zip(at, at[1:], row, strict=False):
            over = b.op("sub", value, b.const(low))
            total.append(b.mul(s, b.clip(over, zero, b.const(high - low))))
    beyond = b.op("max", z[-1], b.const(1.0))
    size = b.op("exp", b.add(*total))
    for _ in range(round(GROWTH)):
        size = b.mul(size, beyond)
    return b.mul(b.const(errors.reach(output, level)), size)
