"""Domain index and prediction intervals of a model, as operations."""

import numpy as np

from jaxnarx.exporters.form import Builder, Value
from jaxnarx.models import GROWTH_EXPONENT, LARGEST_INDEX, Domain, ErrorModel


def domain_index(
    b: Builder, domain: Domain, x: list[Value], step: list[Value]
) -> Value:
    """The index of a sample, one at the border (`Domain.layers`); `x` are the features
    and `step` the inputs' steps from the sample before, physical units."""
    used = len(domain.inputs)
    border = np.asarray(domain.border, float)
    middle, half, rate = (np.asarray(a, float) for a in domain.widths(np))
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
    # |W x| = |R x| with W = Q R, which has half of the entries
    _, triangle = np.linalg.qr(np.asarray(domain.whiten, float) / border[2])
    at = np.triu_indices(len(unit))
    entries = b.parameters(
        "domain_ellipsoid",
        triangle[at],
        "upper triangle, by rows, that makes features of unit size uncorrelated, one "
        "at the border",
    )
    rows = [
        b.dot(entries[at[0] == k], np.asarray(unit, object)[at[1][at[0] == k]])
        for k in range(len(unit))
    ]
    joint = b.add(*(b.square(row) for row in rows))
    near = _nearest(b, domain, border[3], unit)
    far = b.op("sqrt", b.op("max", joint, near))
    return b.op("min", b.largest([far, *alone, *fast]), b.const(LARGEST_INDEX))


def _nearest(b: Builder, domain: Domain, border: float, unit: list[Value]) -> Value:
    """Squared distance to the nearest point,

        min_p |x - p|^2 = |x|^2 + 2 min_p (|p|^2 / 2 - p . x) ,

    with two operations by feature and point in place of three. Rounding makes less than
    1e-15 (|x|^2 + |p|^2) of it, which is nothing where the index is near one.
    """
    values = np.asarray(domain.points, float) / border
    # the mean of the points is the origin, which keeps |x| and |p| small
    middle = values.mean(axis=0)
    values = values - middle[None]
    table = b.parameters(
        "domain_points",
        np.column_stack([0.5 * np.sum(values**2, axis=1), -values]),
        "a row for every stored point of the training: half of its squared length, "
        "then minus its weighted features from their mean, one at the border",
    )
    weight = np.asarray(domain.weight, float) / border
    seen = [
        b.op("sub", b.mul(u, b.const(w)), b.const(m))
        for u, w, m in zip(unit, weight.tolist(), middle.tolist(), strict=True)
    ]
    least = b.smallest([b.add(half, b.dot(row, seen)) for half, *row in table])
    length = b.add(*(b.square(x) for x in seen))
    near = b.add(length, b.add(least, least))
    return b.op("max", near, b.const(0.0))


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
    for _ in range(round(GROWTH_EXPONENT)):
        size = b.mul(size, beyond)
    return b.mul(b.const(errors.reach(output, level)), size)
