"""The verb `identify`: the best model that a search finds, or one method's."""

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.confidence import attach_domain_and_intervals
from jaxnarx.data import Channels, Dataset, Groups, join, match_channels
from jaxnarx.errors import DataError, SpecError, suggest
from jaxnarx.identification._by_method import Events, run_method
from jaxnarx.identification.search import search
from jaxnarx.models import Network
from jaxnarx.partition import rest_points
from jaxnarx.settings import PRESETS, Identification, Physics, require_physics
from jaxnarx.solution import Solution

VALIDATION_GROUP = "validation"
"""The group of the records that are for validation."""


@guard_arguments
def identify(
    data: Dataset,
    method: Identification | None = None,
    *,
    preset: str = "good",
    budget: float | None = None,
    candidates: int | None = None,
    outputs: Sequence[str] = (),
    states: int | None = None,
    groups: Groups | None = None,
    validation: Dataset | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: Events | None = None,
    physics: Mapping[str, Physics] | None = None,
    at_rest: Dataset | None = None,
) -> Solution[Network]:
    """The best model of the data, found by a search or made as `method` says.

    The search looks at the data, then tries candidates from cheap to rich: a constant,
    linear ARX and output-error models, filters, polynomials, regions with shared
    feedback in closed form (`jaxnarx.partition`), polynomials of past outputs and
    LOLIMOT, and models with hidden states (both trained on stretches of long records).
    Of an output far from symmetric a root is modelled in closed form too. The last
    candidate is the mean of up to three others, each the best of its kind, where that
    gains more than 3 %.
    Each is scored by its free run in leave-group-out cross-validation (models with
    hidden states are trained on from the fit to all records rather than refitted). A
    candidate that diverges on any group is rejected. The result is the cheapest to
    compute within one standard error, and 5 %, of the best, or the cheapest within one
    standard error alone where that promises less by nested cross-validation, trained on
    all records (`preset="best"`: the best itself). The same data and settings give the
    same model.

    With a method the verbs `select`, `grow` and `refine` follow one another; their
    errors pass as they are. Outputs that are neither modelled nor scheduled on are left
    out of the network's channels. Either way the network has a domain
    (`jaxnarx.domain`).

    Args:
        data: Records to be trained on.
        method: The settings of all steps. Without it the search decides; the arguments
            that follow, but for `validation` and `progress`, are the search's own.
        preset: `"quick"` (about a minute), `"good"`, `"best"` (an hour and more; the
            smallest error whatever it costs), `"ecu"` (the fewest operations within 5 %
            of the best, stable for certain) or `"linear"`; see
            `jaxnarx.settings.PRESETS`.
        budget: Time for the search [s], shared by the outputs, after which no further
            candidate is begun; the result then depends on the machine. Default: none,
            the preset's counts bound the search.
        candidates: Most candidates of every output; default the preset's.
        outputs: Names of the outputs to be modelled; default all.
        states: Number of hidden states of the candidates that have some; 0 for none
            with any. Default: what the preset tries.
        groups: Groups of records that are held out together (`jaxnarx.data.groups`); by
            default those that the records state, else records that repeat one another's
            inputs. Not beside `validation`.
        validation: Records that judge growth and refinement of a method, and tell how
            large its errors are (`jnx.intervals`). A search
            counts them among the data, as a group of their own.
        folder: Folder to which the search writes every candidate that it has tried. The
            same call goes on there where an earlier one stopped; SpecError where the
            folder holds the search of other data or settings.
        progress: A function called on the host with dictionaries. Of a search: `verb`
            `"search"`, and after every candidate its `row`, the row `chosen` so far,
            how many are `done` `of` how many, `seconds` passed and `left` (None where
            that is not known); while one is tried, its `output`, its `number` and as
            `trying` its `family`, `name` and `fold` of `folds`. Of a method: `verb` is
            `"select"`, `"grow"` or `"refine"`; with `candidates`, their number, before
            the first, with `solution` after each, else with a row of that verb's own
            progress.
        physics: Signs of gains at rest by output (`jnx.identification.Physics`), such
            as `{"NOx": Physics(increases_with=["ignition"])}`, and longest time
            constants. They are constraints of candidates in closed form, signs at
            measured samples spread over the data, and a veto on all others;
            `unconstrained` of a candidate tells what signs cost.
        at_rest: Operating points measured at rest: every sample is one, with inputs
            that were held until the outputs had settled. Candidates in closed form are
            trained on them too, each as much as on a settled record as long as the
            memory; the network's ranges hold them. Errors are those of records alone.

    Returns:
        `value` is the network. Of a search: `stats["leaderboard"]` holds all candidates
        and `stats["look"]` what was seen in the data; `status` is `ok`, `budget_spent`
        where it was interrupted or its budget ran out (`value` is the best so far), or
        `diverged` where every candidate diverges (`value` is the safest). Of a method:
        `status` and `detail` are those of the last verb, or of the first that failed,
        and `stats` holds their solutions, `selection`, `grown` and `refined` (None
        without refinement).

    Example:
        fit = jnx.identify(data, jnx.Identification(select=jnx.ForwardOLS(max_terms=2)))
        print(fit.status_name)
    """
    asked = _Wanted(
        preset,
        budget,
        candidates,
        tuple(outputs),
        states,
        groups,
        folder,
        physics,
        at_rest,
    )
    if method is None:
        return _search(data, asked, validation, progress)
    if changed := [f.name for f in dataclasses.fields(asked) if asked.asks(f.name)]:
        raise SpecError(
            f"{changed[0]} belongs to a search; with a method there is none",
            field=changed[0],
        )
    found = run_method(data, method, validation, progress)
    value = attach_domain_and_intervals(found.value, data, apart=validation)
    return dataclasses.replace(found, value=value)


@dataclasses.dataclass(frozen=True)
class _Wanted:
    """The arguments of a search."""

    preset: str = "good"
    budget: float | None = None
    candidates: int | None = None
    outputs: tuple[str, ...] = ()
    states: int | None = None
    groups: Groups | None = None
    folder: str | os.PathLike[str] | None = None
    physics: Mapping[str, Physics] | None = None
    at_rest: Dataset | None = None

    def asks(self, name: str) -> bool:
        """Whether something else than the default is asked for."""
        value, usual = getattr(self, name), getattr(_Wanted(), name)
        return value is not usual and not (isinstance(value, str) and value == usual)

    def check(self, channels: Channels) -> None:
        """SpecError where a setting makes no sense."""
        if self.preset not in PRESETS:
            raise SpecError(
                f"preset: there is no {self.preset!r}. {suggest(self.preset, PRESETS)}",
                field="preset",
            )
        if self.budget is not None and not 0 < self.budget < math.inf:
            raise SpecError(
                f"budget must be a positive number of seconds, got {self.budget}",
                field="budget",
            )
        if self.candidates is not None and self.candidates < 1:
            raise SpecError(
                f"candidates must be at least 1, got {self.candidates}",
                field="candidates",
            )
        if self.states is not None and self.states < 0:
            raise SpecError(
                f"states must not be negative, got {self.states}", field="states"
            )
        for name in self.outputs:
            if name not in channels.output_names:
                known = suggest(name, channels.output_names)
                raise SpecError(
                    f"outputs: there is no output {name!r}. {known}", field="outputs"
                )
        outputs = self.outputs or channels.output_names
        require_physics(self.physics or {}, channels.input_names, outputs)


def _search(
    data: Dataset,
    asked: _Wanted,
    validation: Dataset | None,
    progress: Events | None,
) -> Solution[Network]:
    asked.check(data.channels)
    known = data.channels
    names = asked.outputs or known.output_names
    kept = tuple(c for c in known.outputs if c.name in names)
    chosen = Channels(known.inputs, kept)
    data = match_channels(data, chosen)[0]
    at_rest = asked.at_rest
    if at_rest is not None:
        at_rest = _match_points(at_rest, chosen)
        # Points have no time; the ranges are told by records and points together.
        at_rest = dataclasses.replace(at_rest, sample_time=data.sample_time)
    if validation is not None and asked.groups is not None:
        raise SpecError(
            "groups and validation: name the group of all records, those for "
            "validation among the data",
            field="groups",
        )
    if validation is not None:
        data = with_group(data, validation, VALIDATION_GROUP)
    _require_moving(data)
    return search(
        data,
        preset=asked.preset,
        budget=asked.budget,
        candidates=asked.candidates,
        groups=asked.groups,
        outputs=[c.name for c in kept],
        states=asked.states,
        folder=None if asked.folder is None else Path(asked.folder),
        progress=progress,
        physics=asked.physics or {},
        at_rest=at_rest,
    )


def _match_points(at_rest: Dataset, channels: Channels) -> Dataset:
    """Operating points of these channels; SpecError where one is not theirs, DataError
    where an output has no point."""
    try:
        at_rest = match_channels(at_rest, channels)[0]
    except SpecError as error:
        raise SpecError(f"at_rest: {error}", field="at_rest") from error
    for name in channels.output_names:
        if rest_points(at_rest, name) is None:
            raise DataError(
                f"at rest: no operating point has {name!r} and all inputs. Add some, "
                "or model the other outputs apart.",
                channel=name,
            )
    return at_rest


def _require_moving(data: Dataset) -> None:
    """DataError where an output that is to be modelled is constant."""
    inputs = len(data.channels.inputs)
    for o, name in enumerate(data.channels.output_names):
        seen = [r.y[r.valid[:, inputs + o], o] for r in data]
        values = np.concatenate(seen)
        if not len(values) or np.ptp(values) == 0:
            raise DataError(
                f"output {name!r} is constant over all records; there is nothing to "
                "identify. Model another output, or take other records.",
                channel=name,
            )


def with_group(data: Dataset, more: Dataset, name: str) -> Dataset:
    """The records of both; the second ones are a group of that name."""
    named = tuple(dataclasses.replace(record, group=name) for record in more)
    return join([data, dataclasses.replace(more, records=named)])
