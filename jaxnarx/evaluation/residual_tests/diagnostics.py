"""The result of the verb `diagnose`, and its text."""

import dataclasses
import textwrap
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Channel
from jaxnarx.evaluation.gain_signs import GainFinding
from jaxnarx.evaluation.residual_tests.coefficients import Coefficient, Influence
from jaxnarx.evaluation.residual_tests.lag_tests import LagTest
from jaxnarx.evaluation.residual_tests.operating_point import OperatingPoint
from jaxnarx.evaluation.residual_tests.scalar_tests import ScalarTest
from jaxnarx.evaluation.table import strict
from jaxnarx.formatting import page

HOW_ESTIMATED = {
    "global": "fitted to these samples by least squares: the bounds allow for it",
    "local": "local models fitted to these samples each by itself: the bounds allow "
    "for it",
    "no": "not the least-squares fit to these samples (other data, or trained on the "
    "simulation error): the bounds take the model as given. Training on the simulation "
    "error leaves one-step residuals that are not white, by design",
}


NOTICEABLE_VARIANCE_SHARE = 0.01
"""Share of the residual's variance from which a finding speaks against the model: with
tens of thousands of samples every test finds something."""


@dataclasses.dataclass(frozen=True, eq=False)
class OutputDiagnostics:
    """The residual analysis of one output; physical units.

    `parameters` is the effective number of those that shape the residuals, `estimated`
    says how (see `OneStep`); `errors` holds the one-step residuals by record, NaN where
    there is none; `condition` is that of the least squares problem, or of each local
    one.
    """

    output: Channel
    samples: int
    parameters: float
    mean: float
    deviation: float
    estimated: str
    errors: tuple[Float[np.ndarray, " _"], ...]
    lag_tests: tuple[LagTest, ...]
    scalar_tests: tuple[ScalarTest, ...]
    operating_points: tuple[OperatingPoint, ...]
    coefficients: tuple[Coefficient, ...]
    condition: tuple[float, ...]
    influences: tuple[Influence, ...]

    def test(self, name: str, signal: str = "") -> LagTest:
        """The correlation test of that name, of that input where it has one."""
        for test in self.lag_tests:
            if (test.name, test.signal) == (name, signal):
                return test
        raise KeyError(f"no test {name!r} of {signal!r}")

    @property
    def rows(self) -> tuple[tuple[str, float, str], ...]:
        """(test, p, remark) of everything tested, in the order shown."""
        lags = [
            (f"{t.name}, {t.signal}" if t.signal else t.name, t.p, _remark(t))
            for t in self.lag_tests
            if t.tested.any()
        ]
        single = [(t.name, t.p, t.remark) for t in self.scalar_tests]
        points = [
            (f"means over {o.variable}", o.p, f"{len(o.samples)} bins")
            for o in self.operating_points
        ]
        return (*lags, *single, *points)

    @property
    def effects(self) -> dict[str, float]:
        """The share of the residual's variance that each test of `rows` is about.

        For a correlation test it is the squared correlation of its strongest lag, for
        that of Ljung and Box the share that the residual's past predicts, for a mean
        its square. Runs and normality have none.
        """
        lags = {
            (f"{t.name}, {t.signal}" if t.signal else t.name): t.effect
            for t in self.lag_tests
        }
        own = self.test("autocorrelation")
        whole = float(np.hypot(self.mean, self.deviation))
        single = {
            "Ljung-Box": own.together,
            "mean": (self.mean / whole) ** 2 if whole > 0 else 0.0,
        }
        return (
            lags
            | single
            | {f"means over {o.variable}": o.effect for o in self.operating_points}
        )

    def strong(self, level: float) -> list[str]:
        """The tests `found` with an effect of at least `NOTICEABLE_VARIANCE_SHARE`,
        largest first."""
        effect = self.effects
        kept = [
            n
            for n in self.failed_tests(level)
            if effect.get(n, 0.0) >= NOTICEABLE_VARIANCE_SHARE
        ]
        return sorted(kept, key=lambda n: -effect[n])

    def failed_tests(self, level: float) -> list[str]:
        """Tests that speak against the model, at a joint `level` for all of them.

        Holm 1979: the n-th smallest p is compared with level/(tests + 1 - n). Normality
        is left out: a right model may have noise that is not normal.
        """
        rows = [r for r in self.rows if not r[0].startswith("normality")]
        names = []
        for n, (name, p, _) in enumerate(sorted(rows, key=lambda r: r[1])):
            if p > level / (len(rows) - n):
                break
            names.append(name)
        return names


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnostics:
    """Residual analysis of all outputs; `print` shows the tables.

    Below them steady-state gains that change sign over the data, or jump.
    """

    outputs: tuple[OutputDiagnostics, ...]
    lags: int
    level: float
    gains: tuple[GainFinding, ...] = ()
    """Steady-state gains that change sign or jump."""

    def __getitem__(self, output: str) -> OutputDiagnostics:
        for one in self.outputs:
            if one.output.name == output:
                return one
        raise KeyError(f"no diagnostics of {output!r}")

    @property
    def summary(self) -> tuple[str, ...]:
        """A sentence per output: what speaks against the model, if anything."""
        return tuple(_sentence(one, self.level) for one in self.outputs)

    @property
    def table(self) -> str:
        """Tests and coefficients of every output as text."""
        blocks = [_block(one, self.level) for one in self.outputs]
        gains = ["\n".join(map(str, self.gains))] if self.gains else []
        return "\n\n".join([*blocks, *gains])

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page

    def to_dict(self) -> dict[str, Any]:
        """Everything but the residuals themselves, as strict JSON values."""
        outputs = {}
        for one in self.outputs:
            names = {f.name for f in dataclasses.fields(one)} - {"errors", "lag_tests"}
            values: dict[str, Any] = {n: strict(getattr(one, n)) for n in sorted(names)}
            values["lag_tests"] = [
                {k: v for k, v in strict(t).items() if k != "covariance"}
                for t in one.lag_tests
            ]
            values["found"] = one.failed_tests(self.level)
            values["effects"], values["strong"] = one.effects, one.strong(self.level)
            outputs[one.output.name] = values
        found = {"lags": self.lags, "level": self.level, "outputs": outputs}
        return found | {"gains": strict(self.gains)}


def _remark(test: LagTest) -> str:
    out = test.outside
    if not len(out):
        return ""
    listed = ", ".join(str(k) for k in out[:5]) + (" ..." if len(out) > 5 else "")
    return f"outside at lag{'s' if len(out) > 1 else ''} {listed}"


def _sentence(one: OutputDiagnostics, level: float) -> str:
    found, strong = one.failed_tests(level), one.strong(level)
    sure = f"{100 * (1 - level):g} %"
    if not found:
        return f"{one.output.name}: no test speaks against the model ({sure})."
    faint = len(found) - len(strong)
    least = f"{100 * NOTICEABLE_VARIANCE_SHARE:g} %"
    rest = f"{faint} of {len(one.rows)} tests find less than {least}"
    rest += f" of the residual's variance, with {one.samples} samples"
    if not strong:
        return (
            f"{one.output.name}: no test speaks against the model to an extent that "
            f"matters; {rest} ({sure})."
        )
    effect = one.effects
    shown = [f"{name} ({100 * effect[name]:.2g} %)" for name in strong[:4]]
    more = f" and {len(strong) - 4} more" if len(strong) > 4 else ""
    return (
        f"{one.output.name}: {', '.join(shown)}{more} speak against the model ({sure}; "
        "in brackets the share of the residual's variance)"
        + (f"; {rest}." if faint else ".")
    )


def _block(one: OutputDiagnostics, level: float) -> str:
    label = one.output.label
    head = [
        f"{label}: {one.samples} one-step residuals, mean {one.mean:.4g}, standard "
        f"deviation {one.deviation:.4g}, {one.parameters:.1f} parameters",
        textwrap.fill(HOW_ESTIMATED[one.estimated], 88),
    ]
    width = max(len(row[0]) for row in one.rows)
    tests = [f"{'test':{width}s} {'p':>10s} {'effect':>8s}"]
    found, strong, effects = one.failed_tests(level), one.strong(level), one.effects
    for name, p, remark in one.rows:
        mark = "*" if name in strong else "." if name in found else " "
        effect = f"{100 * effects[name]:.2g} %" if name in effects else ""
        tests.append(f"{name:{width}s} {p:10.3g} {effect:>8s} {mark} {remark}".rstrip())
    note = [
        f"* speaks against the model, all tests together held to {100 * level:g} %; .",
        f"does, but is about less than {100 * NOTICEABLE_VARIANCE_SHARE:g} % (effect)",
        "of the residual's variance",
    ]
    note = textwrap.fill(" ".join(note), 88)
    return "\n".join([*head, "", *tests, note, "", *_coefficients(one), *_top(one)])


def _coefficients(one: OutputDiagnostics) -> list[str]:
    # Inside the function: see `error_reduction`.
    from jaxnarx.selection import coefficient_lines

    lines = []
    for m, number in enumerate(dict.fromkeys(c.model for c in one.coefficients)):
        own = [c for c in one.coefficients if c.model == number]
        condition = one.condition[min(m, len(one.condition) - 1)]
        lines.append(f"local model {number}, condition {condition:.3g}")
        lines += coefficient_lines(
            [c.term for c in own],
            [c.value for c in own],
            [c.error for c in own],
            [c.t for c in own],
            [c.p for c in own],
            [c.err for c in own],
        )
        lines.append("")
    return lines


def _top(one: OutputDiagnostics) -> list[str]:
    lines = [
        f"{'highest leverage':24s} {'time [s]':>10s} {'leverage':>9s} {'resid.':>7s}"
    ]
    for i in one.influences[:5]:
        lines.append(
            f"{i.record[:24]:24s} {i.time:10.5g} {i.leverage:9.3g} {i.studentised:7.2f}"
        )
    return lines
