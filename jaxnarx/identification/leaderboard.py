"""Candidates in the order of what they promise, judged by groups left out."""

import csv
import dataclasses
import io
import math
import statistics
from collections.abc import Iterator
from typing import Any

from jaxnarx.argument_checks import require_fit
from jaxnarx.deprecation import old_method
from jaxnarx.errors import SpecError
from jaxnarx.files import cell
from jaxnarx.formatting import align_columns, page, some

EQUAL_STANDARD_ERRORS = 1.0
"""Standard errors within which a cheaper model counts as no worse than the best."""
MOST_BROKEN = 4.0
"""Nested error, over that of the free run on groups left out, beyond which a candidate
does not keep what it promises: of a stirred reactor (CSTR) a polynomial NARX promised
.0066, its nested error was .058 and that of the test .46."""
EQUAL_ERROR_SHARE = 0.05
"""Share of the error that a cheaper model may give away."""
DOMINANT_SHARE, DOMINANT_GROUPS = 0.5, 3
"""Share of the loss from which one group decides alone, where there are so many."""
AGAINST_PHYSICS = "against physics"
"""Status of a candidate vetoed by physics."""
LEAST_ERROR = 1e-9
"""Least error of a group in a geometric mean."""
LARGEST_FIGURE = 1e100
"""Largest figure of a candidate in a file; its square is a number too."""


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One candidate for one output.

    Errors are NRMSE: root mean square over the standard deviation of the output, pooled
    over the samples that count. `free_run` is the held-out error of leave-group-out
    cross-validation: every model runs freely over records that it was not trained on.
    Models with hidden states are trained on all records first, then once more without
    the held-out ones, from the parameters found.
    """

    output: str
    number: int
    """Counts the candidates of an output in the order in which they finished: of the
    first output from 1, of the second from 1001; `jaxnarx choose` is given it."""
    family: str
    """Constant, ARX, OE, filtered inputs, polynomial, shared feedback, LOLIMOT, ..."""
    name: str
    """Description within its family, in words."""
    free_run: float | None = None
    """None where a model diverged, or there is none."""
    standard_error: float | None = None
    """Standard error of `free_run`, over groups."""
    groups: tuple[float | None, ...] = ()
    """`free_run` of every group."""
    nested: float | None = None
    """The same error by nested cross-validation, where the candidate was chosen: made
    again without every group in turn, with its structure alone kept
    (`jaxnarx.identification.nested`)."""
    nested_groups: tuple[float | None, ...] = ()
    """`nested` of every group."""
    data_factor: float | None = None
    """About what the last group gains: `free_run`, of models made without one group,
    over the same error of those made without two, at most one. Known in closed form."""
    one_step: float | None = None
    """One-step error on the same records."""
    diverged: int = 0
    """Runs that diverged; any is a veto. Runs of candidates that are trained step by
    step are held-out records; runs of closed-form candidates, whose held-out errors are
    those of runs held to the trained range, are held-out groups, and records run by the
    model of all groups."""
    operations: int | None = None
    """Operations for one sample of the exported code, without domain index and
    intervals."""
    parameters: int | None = None
    seconds: float = 0.0
    pole: float | None = None
    """Largest modulus of a local model's poles; from 1 on it does not forget its past,
    and rounding in single precision adds up."""
    bounded: bool | None = None
    """Whether every run is proven to stay bounded while its inputs are."""
    unconstrained: float | None = None
    """`free_run` of the same candidate without the signs of physics, where these are
    constraints of its least squares."""
    status: str = "ok"
    """`ok`, `diverged`, `against physics`, `failed` or `skipped`."""
    detail: str = ""

    @property
    def forgets(self) -> bool:
        """Whether no local model is known to keep its past for ever."""
        return self.pole is None or self.pole < 1

    @property
    def promised(self) -> float | None:
        """The error of a network of all records: the nested one where it is known,
        which lacks a group, times `data_factor`; else the held-out one."""
        if self.nested is None:
            return self.free_run
        return self.nested * (self.data_factor or 1.0)

    @property
    def promised_groups(self) -> tuple[float | None, ...]:
        """... of every group."""
        if self.nested is None:
            return self.groups
        factor = self.data_factor or 1.0
        return tuple(e if e is None else factor * e for e in self.nested_groups)

    @property
    def eligible(self) -> bool:
        """Whether it may be chosen."""
        return self.status == "ok" and self.free_run is not None

    @property
    def keeps_promise(self) -> bool:
        """Whether, made again without every group, it has up to `MOST_BROKEN` times the
        error, as far as that is known."""
        if self.nested is None or self.free_run is None:
            return True
        return self.nested <= MOST_BROKEN * self.free_run

    def to_dict(self) -> dict[str, Any]:
        """The candidate as plain values, for files."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, table: dict[str, Any]) -> "Candidate":
        """Read a candidate from a file; SpecError names what it cannot be."""
        fields = {field.name: field for field in dataclasses.fields(cls)}
        if not isinstance(table, dict):
            raise SpecError("a candidate is a table of its fields")
        if other := sorted(set(table) - set(fields)):
            raise SpecError(f"a candidate has no field {other[0]}", field=other[0])
        for name, field in fields.items():
            if field.default is dataclasses.MISSING and name not in table:
                raise SpecError(f"a candidate has no {name}", field=name)
        for name, value in table.items():
            require_fit("a candidate", name, value, fields[name].type)
            _require_figures(name, value)
        lists = {n: tuple(table.get(n, ())) for n in ("groups", "nested_groups")}
        own: dict[str, Any] = table | lists
        return cls(**own)


@dataclasses.dataclass(frozen=True)
class Leaderboard:
    """All candidates of an identification, output by output, best first."""

    rows: tuple[Candidate, ...]
    group_names: tuple[str, ...] = ()
    rule: str = "near"
    """`near`: the cheapest to compute within one standard error of the best (that of
    the difference, group by group) and 5 %; `share`: within 5 % of it; `best`. Among
    those a candidate whose local models forget their past comes before one whose do
    not, and one whose runs are proven bounded before one that might run away. Where one
    of three groups or more has over half of the loss, `near` are those within one
    standard error of the best whose geometric mean over groups is within 5 % of the
    least: the pooled error would be that group's alone. Of that candidate and
    of cheaper ones that were made again without every group too (`nested`), the
    smallest nested error decides. Candidates whose nested error is far larger than what
    they promise (`keeps_promise`) come last, unless it is the smallest of all."""

    def __str__(self) -> str:
        """Candidates of every output, best first; the chosen one has a star."""
        lines = [f"Leaderboard: {len(self)} candidates"]
        for output in self.outputs:
            chosen = self.choose(output)
            rows = [("", output, "free run", "operations", "parameters", "family", "")]
            rows += [_line(row, row == chosen) for row in self.of(output)]
            left = [True, *(False,) * 4, True, True]
            lines += some(align_columns(rows, left), 24)
        return "\n".join(lines)

    _repr_html_ = page

    def __iter__(self) -> Iterator[Candidate]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def outputs(self) -> list[str]:
        """Names, in the order of their first candidates."""
        return list(dict.fromkeys(row.output for row in self.rows))

    def of(self, output: str) -> list[Candidate]:
        """Rows of one output, best first; those that may not be chosen come last."""
        return sorted((r for r in self.rows if r.output == output), key=_place)

    def best(self, output: str) -> Candidate | None:
        """The smallest error, whatever it costs."""
        return next((row for row in self.of(output) if row.eligible), None)

    def choose(self, output: str) -> Candidate | None:
        """The one to use by the rule; None where every candidate is vetoed."""
        chosen = self._choose_kept(output)
        if chosen is None or chosen.nested is None:
            return chosen
        broken = [r for r in self.of(output) if r.eligible and not r.keeps_promise]
        judged = [r for r in (chosen, *broken) if r.nested is not None]
        return min(judged, key=lambda r: (r.nested, r.number))

    def _choose_kept(self, output: str) -> Candidate | None:
        """The one to use, of those that keep their promise where there are some."""
        best = self.best(output)
        if best is None:
            return best
        rows = self._fine(output)
        if self.rule == "best":
            return _least_nested(best, rows)
        if self.rule == "share":
            near = [r for r in rows if _is_within(r, best)]
        elif self.dominant_group(output):
            near = _near_in_every_group(rows, best)
        else:
            near = [r for r in rows if _is_near(r, best)]
        near = _safest(near)
        chosen = min(near, key=lambda r: (_cost(r), _error(r)))
        as_safe = [r for r in rows if r.bounded or not chosen.bounded]
        return _least_nested(chosen, as_safe)

    def simplest(self, output: str) -> Candidate | None:
        """The cheapest to compute within one standard error of the best, however much
        more its error is; None under another rule than `near`.

        With few groups that error is large, and many regions fit what the groups have
        in common by chance: nested errors tell the two apart.
        """
        best = self.best(output)
        if best is None or self.rule != "near":
            return None
        rows = self._fine(output)
        near = [r for r in rows if _is_equal(r, best)]
        near = _safest(near)
        return min(near, key=lambda r: (_cost(r), _error(r)))

    def _fine(self, output: str) -> list[Candidate]:
        """Eligible candidates that keep their promise, or all if none does."""
        rows = [r for r in self.of(output) if r.eligible]
        return [r for r in rows if r.keeps_promise] or rows

    chosen = old_method("chosen", "choose")

    def above_best(self, row: Candidate) -> tuple[float, float] | None:
        """The difference of the error to that of the best, and its standard error; None
        for the best itself and for what may not be chosen."""
        best = self.best(row.output)
        if best is None or best == row or not row.eligible:
            return None
        return _excess(row, best)

    def worst_group(self, row: Candidate) -> tuple[str, float] | None:
        """Name and error of the group that a candidate serves worst, by what it
        promises."""
        seen = [
            (error, name)
            for error, name in zip(row.promised_groups, self.group_names, strict=False)
            if error is not None
        ]
        if not seen:
            return None
        error, name = max(seen)
        return name, error

    def dominant_group(self, output: str) -> tuple[str, float] | None:
        """Name and share of the group that has over half of the loss of the best
        candidate, of three or more; None where there is none."""
        best = self.best(output)
        if best is None:
            return None
        losses = [
            (error**2, name)
            for error, name in zip(best.groups, self.group_names, strict=False)
            if error is not None
        ]
        total = math.fsum(loss for loss, _ in losses)
        if len(losses) < DOMINANT_GROUPS or not total:
            return None
        loss, name = max(losses)
        return (name, loss / total) if loss > DOMINANT_SHARE * total else None

    def to_csv(self) -> str:
        """A table with one line a candidate."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["rank", "chosen", *ROW_COLUMNS, *BOARD_COLUMNS])
        for output in self.outputs:
            chosen = self.choose(output)
            for rank, row in enumerate(self.of(output), 1):
                name, error = self.worst_group(row) or ("", None)
                values = [
                    rank,
                    int(row == chosen),
                    *(getattr(row, k) for k in ROW_COLUMNS),
                ]
                values += [name, error, *(self.above_best(row) or (None, None))]
                writer.writerow(cell(v) if isinstance(v, str) else v for v in values)
        return file.getvalue()


ROW_COLUMNS = (
    "output number family name free_run standard_error nested promised unconstrained "
    "one_step diverged operations parameters seconds status detail"
).split()
"""Columns of the table that are facts of a row alone."""
BOARD_COLUMNS = (
    "worst_group worst_group_error above_best above_best_standard_error".split()
)
"""Columns that follow from all rows."""


def _require_figures(name: str, value: Any) -> None:
    """SpecError where a figure is negative, or larger than a file may hold."""
    for one in value if isinstance(value, list | tuple) else (value,):
        if isinstance(one, int | float) and not 0 <= one <= LARGEST_FIGURE:
            raise SpecError(
                f"{name} is {one}, but must be from 0 to {LARGEST_FIGURE:g}", field=name
            )


def _line(row: Candidate, chosen: bool) -> tuple[str, ...]:
    """Cells of a candidate; where it has no error, what became of it."""
    error = row.status if row.free_run is None else f"{row.free_run:.4g}"
    if row.free_run is not None and row.standard_error:
        error += f" ± {row.standard_error:.2g}"
    sizes = ("" if n is None else str(n) for n in (row.operations, row.parameters))
    star = "*" if chosen else ""
    return star, str(row.number), error, *sizes, row.family, row.name


def _error(row: Candidate) -> float:
    return math.inf if row.free_run is None else row.free_run


def _cost(row: Candidate) -> float:
    return math.inf if row.operations is None else float(row.operations)


def _safest(rows: list[Candidate]) -> list[Candidate]:
    """Rows whose models forget their past, and of these the proven bounded ones, where
    there are some."""
    rows = [r for r in rows if r.forgets] or rows
    return [r for r in rows if r.bounded] or rows


def _place(row: Candidate) -> tuple[bool, bool, float, float]:
    return (not row.eligible, not row.keeps_promise, _error(row), _cost(row))


def _least_nested(chosen: Candidate, rows: list[Candidate]) -> Candidate:
    """The least nested error of the chosen one and of those that cost less, where its
    own is known."""
    if chosen.nested is None:
        return chosen
    known = [r for r in rows if r.nested is not None and _cost(r) < _cost(chosen)]
    return min([chosen, *known], key=lambda r: (r.nested, _cost(r)))


def _is_within(row: Candidate, best: Candidate) -> bool:
    """Whether the error is at most `EQUAL_ERROR_SHARE` above that of the best."""
    return _error(row) <= (1 + EQUAL_ERROR_SHARE) * _error(best)


def _is_near(row: Candidate, best: Candidate) -> bool:
    """Whether the error exceeds that of the best by a standard error at most.

    The standard error is that of the difference, group by group: groups differ in how
    hard they are, which says nothing about the candidates. With few groups that error
    is large; more than `EQUAL_ERROR_SHARE` is not given away.
    """
    return _is_within(row, best) and _is_equal(row, best)


def _is_equal(row: Candidate, best: Candidate) -> bool:
    """Whether the difference of two errors is within its standard error."""
    difference, error = _excess(row, best)
    return difference <= EQUAL_STANDARD_ERRORS * error


def _near_in_every_group(rows: list[Candidate], best: Candidate) -> list[Candidate]:
    """Those within a standard error of the best that are as good in all groups."""
    equal = []
    for row in rows:
        difference, error = _excess(row, best)
        if difference <= EQUAL_STANDARD_ERRORS * error:
            equal.append(row)
    least = min(map(_geometric_mean, equal))
    limit = (1 + EQUAL_ERROR_SHARE) * least
    return [row for row in equal if _geometric_mean(row) <= limit]


def _geometric_mean(row: Candidate) -> float:
    """The geometric mean of the errors of all groups."""
    logs = [math.log(max(e, LEAST_ERROR)) for e in row.groups if e is not None]
    return math.exp(statistics.fmean(logs)) if logs else math.inf


def _excess(row: Candidate, best: Candidate) -> tuple[float, float]:
    """The difference of two errors and its standard error, by groups.

    Squares are what adds up over groups; their difference over the sum of both errors
    is that of the errors. With one group the standard error is that of the best.
    """
    pairs = [
        (mine**2 - theirs**2)
        for mine, theirs in zip(row.groups, best.groups, strict=False)
        if mine is not None and theirs is not None
    ]
    if len(pairs) < 2:
        return _error(row) - _error(best), best.standard_error or 0.0
    both = (_error(row) + _error(best)) or 1.0
    error = statistics.stdev(pairs) / math.sqrt(len(pairs))
    return statistics.fmean(pairs) / both, error / both
