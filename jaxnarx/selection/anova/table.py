"""Analysis of variance: which lagged variables matter, and which act together.

This comes before any polynomial: each variable is cut into a few levels, and the
outputs' means over the cells are compared (5.27). Terms of a pool are then taken from
the effects that stay.

Lind and Ljung, "Regressor selection with the analysis of variance method", Automatica
41 (2005); "Regressor and structure selection in NARX models using a structured ANOVA
approach", Automatica 44 (2008); thesis (5.27) to (5.31).
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.special import fdtri

from jaxnarx.errors import DataError
from jaxnarx.formatting import page
from jaxnarx.regressors import Pool, Rows
from jaxnarx.selection.anova.cells import Effect, FTest, cut
from jaxnarx.selection.anova.model import Codes
from jaxnarx.selection.anova.penalised import shrink
from jaxnarx.selection.anova.sequence import sequence
from jaxnarx.settings import Anova

SHOWN_ROWS = 30
"""Rows of the table's text."""


@dataclasses.dataclass(frozen=True)
class EffectTest:
    """One effect and its deciding test.

    `variables` are places in `[1, x_1 ... x_V]`, `squares` its sum of squares with
    `freedom` degrees of freedom against `spare` of the error, `share` its part of the
    total sum of squares tested (0 to 1). When effects are tested one after the other, a
    kept effect has its partial F test in the model of all kept ones, another its last
    test on what these leave of the output. `weight` is c of (5.30); in the balanced
    form the closed solution max(0, 1 - quantile / f) of that single test. `balanced` is
    True for a test of cells of equal size. `reason` says why there was no test, ""
    where there was; then `freedom` and `f` are 0 and `p` is 1.
    """

    variables: Effect
    freedom: int = 0
    spare: int = 0
    squares: float = 0.0
    share: float = 0.0
    f: float = 0.0
    p: float = 1.0
    weight: float = 0.0
    significant: bool = False
    balanced: bool = False
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class AnovaTable:
    """Effects of lagged variables on one output, the kept ones first, then by p.

    `levels` is the number of levels of each variable; `together` says that all were in
    one test, not one after the other.
    """

    output: str
    names: tuple[str, ...]
    levels: tuple[int, ...]
    effects: tuple[EffectTest, ...]
    rows: int
    together: bool
    method: Anova

    @property
    def significant(self) -> tuple[Effect, ...]:
        """Variables of the effects that are kept."""
        return tuple(e.variables for e in self.effects if e.significant)

    def of(self, *variables: int | str) -> EffectTest:
        """The effect of these variables, by name or by place from 1."""
        places = [
            self.names.index(v) + 1 if isinstance(v, str) else v for v in variables
        ]
        wanted = tuple(sorted(places))
        return next(e for e in self.effects if e.variables == wanted)

    def label(self, effect: Effect) -> str:
        """`u[t-1] x y[t-2]`."""
        return " x ".join(self.names[v - 1] for v in effect)

    def __str__(self) -> str:
        """A line each for the first effects; `*` marks those that are kept."""
        shown = self.effects[: max(SHOWN_ROWS, len(self.significant))]
        labels = [self.label(e.variables) for e in shown]
        width = max(map(len, labels), default=0)
        lines = [
            *self._head(),
            f"  {'':{width}}   df    share         F        p     c",
        ]
        for label, e in zip(labels, shown, strict=True):
            mark = "*" if e.significant else " "
            lines.append(f"{mark} {label:{width}} {_figures(e)}  {e.reason}")
        if more := len(self.effects) - len(shown):
            lines.append(f"  ... and {more} more that are not significant")
        return "\n".join(line.rstrip() for line in lines)

    _repr_html_ = page

    def _head(self) -> list[str]:
        form = "one penalised model"
        if self.method.form == "balanced":
            form = "one factorial" if self.together else "one effect after the other"
        level = f"{self.method.significance:g}"
        level += " for all together" if self.method.familywise else " each"
        head = [
            f"analysis of variance of {self.output}: {self.rows} samples, {form}, "
            f"{len(self.significant)} of {len(self.effects)} effects significant at "
            f"{level}"
        ]
        few = [
            f"{name} has {n} level{'s' if n > 1 else ''} instead of "
            f"{self.method.levels}"
            for name, n in zip(self.names, self.levels, strict=True)
            if n < self.method.levels
        ]
        return head + few


def _figures(effect: EffectTest) -> str:
    if effect.reason:
        return f"{'-':>4} {'-':>8} {'-':>9} {'-':>8} {'-':>5}"
    return (
        f"{effect.freedom:4d} {100 * effect.share:6.2f} % {effect.f:9.4g} "
        f"{effect.p:8.2g} {effect.weight:5.2f}"
    )


def anova(pool: Pool, rows: Rows, output: int, method: Anova) -> AnovaTable:
    """Test the effects of the pool's lagged variables on one of its outputs.

    `output` counts among `pool.outputs`. A sample takes part where its weight is at
    least half the largest of that output, and all parts count alike. The balanced form
    is described in `anova_sequence`, the penalised in `anova_penalised`. Both take the
    error for independent from sample to sample; what y does within a cell is part of
    it. Variables that move slowly repeat themselves from sample to sample, and then
    more effects pass than `significance` says: a screening, not a proof.

    Constant variables are listed with a reason. A constant output, values that are not
    finite and fewer than four samples raise `DataError`.
    """
    channel = pool.channels.output_names[pool.outputs[output]]
    names = tuple(pool.variable_names)
    x, y = _samples(rows, output, channel, names)
    cuts = [cut(row, method.levels) for row in x]
    levels = tuple(n for _, n in cuts)
    codes = {v + 1: c for v, (c, n) in enumerate(cuts) if n > 1}
    found, together = [], True
    if codes:
        number = {v: levels[v - 1] for v in codes}
        form = _test_by_groups if method.form == "balanced" else _test_by_penalty
        found, together = form(codes, number, y, method)
    found += [
        EffectTest((v,), reason="constant")
        for v, n in enumerate(levels, start=1)
        if n < 2
    ]
    ranked = sorted(
        found, key=lambda e: (not e.significant, bool(e.reason), e.p, -e.f, e.variables)
    )
    return AnovaTable(channel, names, levels, tuple(ranked), len(y), together, method)


def _samples(
    rows: Rows, output: int, channel: str, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "vars rows"], Float[np.ndarray, " rows"]]:
    """Lagged variables and the centred output where the weight counts."""
    weight = np.asarray(rows.weight[output])
    taken = (weight > 0) & (weight >= 0.5 * np.max(weight, initial=0.0))
    if taken.sum() < 4:
        raise DataError(
            f"analysis of variance needs at least 4 samples of {channel!r}, got "
            f"{taken.sum()}; use smaller lags or longer records",
            channel=channel,
        )
    x = np.asarray(rows.v, np.float64)[1:, taken]
    y = np.asarray(rows.y[output], np.float64)[taken]
    for name, values in zip((*names, channel), (*x, y), strict=True):
        if not np.all(np.isfinite(values)):
            raise DataError(
                f"{name!r} has samples that are not finite; mask or remove them first",
                channel=name,
            )
    if np.ptp(y) <= 1e-12 * np.max(np.abs(y)):
        raise DataError(
            f"output {channel!r} is constant; there is no variance to analyse. Choose "
            "another output or other records",
            channel=channel,
        )
    return x, y - y.mean()


def _test_by_groups(
    codes: Codes, levels: dict[int, int], y: Float[np.ndarray, " rows"], method: Anova
) -> tuple[list[EffectTest], bool]:
    outcome = sequence(codes, levels, y, method)
    tests = outcome.tests.values()
    testable = sum(t.freedom > 0 for t in tests)
    level = method.significance / (max(testable, 1) if method.familywise else 1)
    found = [
        _decide(t, t.effect in outcome.kept, max(0.0, 1.0 - _quantile(t, level) / t.f))
        if t.f > 0
        else _decide(t, False, 0.0)
        for t in tests
    ]
    return found, outcome.together


def _quantile(test: FTest, level: float) -> float:
    return float(fdtri(test.freedom, test.spare, 1 - level))


def _decide(test: FTest, significant: bool, weight: float) -> EffectTest:
    reason = ""
    if test.spare < 1:
        reason = "fewer samples than cells"
    elif test.freedom < 1:
        reason = "empty cells: not to be told from other effects"
    if reason:
        return EffectTest(test.effect, reason=reason)
    return EffectTest(
        test.effect,
        test.freedom,
        test.spare,
        test.squares,
        test.squares / test.total if test.total > 0 else 0.0,
        test.f,
        test.p,
        weight,
        significant,
        test.balanced,
    )


def _test_by_penalty(
    codes: Codes, levels: dict[int, int], y: Float[np.ndarray, " rows"], method: Anova
) -> tuple[list[EffectTest], bool]:
    found = shrink(codes, levels, y, method)
    pairs = zip(found.tests, found.weights.tolist(), strict=True)
    over = "passed over: more columns than the model may have"
    return [
        *(_decide(t, weight > 0, weight) for t, weight in pairs),
        *(EffectTest(e, reason=over) for e in found.passed_over),
    ], True


def significant_terms(pool: Pool, table: AnovaTable) -> list[int]:
    """Indices of the pool's terms that the kept effects allow, rising.

    A term stays if all its variables belong to one kept effect: u of the effect u, and
    of the effect u x w also w, u*w and powers of each, since an interaction cannot be
    told from shifted variables without its main effects (strong heredity). The constant
    always stays.
    """
    allowed = ~np.any(pool.factor, axis=1)
    for effect in table.significant:
        allowed |= np.all(np.isin(pool.factor, [0, *effect]), axis=1)
    return np.flatnonzero(allowed).tolist()
