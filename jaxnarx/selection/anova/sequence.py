"""Choice of the effects that stay: tests of small groups of variables, in sequence.

One factorial of all V variables has levels^V cells, 3^41 for an engine with 41 lagged
variables, and no data fill it. Lind and Ljung ("Regressor and structure selection in
NARX models using a structured ANOVA approach", Automatica 44 (2008)) make many small
tests of a few variables each and put the answers together. Here:

1. every effect is tested in the factorial of its own variables;
2. the one with the smallest p enters, if p is below the level and if it also passes a
   partial F test in one model of all effects that have entered (5.28);
3. y loses what that model explains, and the others are tested again on what is left.

At the end those whose partial F no longer passes leave, the worst first. An effect that
only follows a kept one finds nothing left to explain. An effect that left, or failed in
2, does not come back, so the sequence ends.

The first test of each effect is exact under its assumptions: normal errors that are
independent from sample to sample and equally large in all cells, whatever the other
variables do being part of the error. The later ones are approximate: the degrees of
freedom that the model has used are taken off in proportion. The effect of a variable
inside its levels is left over; a neighbour that follows it closely can pass on that,
the more easily the more samples there are.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnarx.selection.anova.cells import (
    LEAST_CELL_SAMPLES,
    CellLayout,
    Effect,
    FTest,
    group_tests,
    lay_out,
    list_effects,
)
from jaxnarx.selection.anova.model import Codes, fit, residual
from jaxnarx.settings import Anova

MOST_HELD_NUMBERS = 40_000_000
"""Sample numbers held at most, so as not to sort into cells again for every step."""


class TestedEffects(NamedTuple):
    """The deciding test of every effect, those that stay, and whether the test was one
    factorial of all variables.
    """

    tests: dict[Effect, FTest]
    kept: list[Effect]
    together: bool


def sequence(
    codes: Codes,
    levels: dict[int, int],
    y: Float[np.ndarray, " rows"],
    method: Anova,
) -> TestedEffects:
    """Test all effects of up to `method.interactions` variables; y is centred.

    In one factorial where the data fill its cells, so that balancing keeps enough of
    them; otherwise in sequence. With `familywise`, the level at the k-th entry is
    significance / (m - k + 1) for m effects (Holm 1979), which holds the chance of a
    single wrong entry.
    """
    effects = list_effects(tuple(codes), method.interactions)
    cells = math.prod(levels.values())
    if method.whole and cells * LEAST_CELL_SAMPLES <= len(y):
        layout = lay_out(list(codes.values()), tuple(levels.values()), method.balance)
        if layout.pick is not None:
            return _test_whole(layout, y, tuple(codes), effects, method)
    return _stepwise(codes, levels, y, effects, method)


def _test_whole(
    layout: CellLayout,
    y: Float[np.ndarray, " rows"],
    group: Effect,
    effects: Sequence[Effect],
    method: Anova,
) -> TestedEffects:
    order = method.interactions
    tests = {t.effect: t for t in group_tests(layout, y, group, effects, order=order)}
    kept: list[Effect] = []
    for effect in sorted(tests, key=lambda e: weakness(tests[e])):
        if tests[effect].p >= _level(tests, len(kept), method):
            break
        kept.append(effect)
    return TestedEffects(tests, kept, True)


def weakness(test: FTest) -> tuple[float, float]:
    """Rank of a test: by p, then by F, for p of strong effects underflows to zero."""
    return test.p, -test.f


def _level(tests: dict[Effect, FTest], kept: int, method: Anova) -> float:
    if not method.familywise:
        return float(method.significance)
    testable = sum(t.freedom > 0 and t.spare > 0 for t in tests.values())
    return method.significance / max(testable - kept, 1)


def _stepwise(
    codes: Codes,
    levels: dict[int, int],
    y: Float[np.ndarray, " rows"],
    effects: Sequence[Effect],
    method: Anova,
) -> TestedEffects:

    def place(e: Effect) -> CellLayout:
        variables = [codes[v] for v in e]
        return lay_out(variables, tuple(levels[v] for v in e), method.balance)

    if len(y) * len(effects) <= MOST_HELD_NUMBERS:
        place = functools.cache(place)

    def test_alone(e: Effect, y: Float[np.ndarray, " rows"], spent: float) -> FTest:
        order = method.interactions
        [test] = group_tests(place(e), y, e, [e], order=order, spent=spent)
        return test

    own = {e: test_alone(e, y, 0.0) for e in effects}
    first = dict(own)
    left = {e for e, t in own.items() if t.freedom and t.spare}
    kept: list[Effect] = []
    decided: dict[Effect, FTest] = {}
    while left:
        best = min(left, key=lambda e: (weakness(own[e]), e))
        level = _level(first, len(kept), method)
        if own[best].p >= level:
            break
        left.remove(best)
        model = fit(codes, levels, [*kept, best], y)
        joint = model.test(len(kept))
        if joint.p >= level:
            decided[best] = joint
            continue
        kept.append(best)
        rest = residual(model, codes, levels, y)
        spent = min(len(model.owner) / len(y), 1.0)
        own |= {e: test_alone(e, rest, spent) for e in left}
    while kept:
        model = fit(codes, levels, kept, y)
        now = {e: model.test(k) for k, e in enumerate(kept)}
        decided |= now
        worst = max(now, key=lambda e: weakness(now[e]))
        if now[worst].p < _level(first, len(kept) - 1, method):
            break
        kept.remove(worst)
    return TestedEffects(own | decided, kept, False)
