"""The verb `export_adaptation`: a model that learns while it runs, as C and as FMU,
proven."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require
from jaxnarx.data import Dataset, stack_records
from jaxnarx.errors import DataError, SpecError
from jaxnarx.exporters import (
    FMI_VERSIONS,
    ONLY_DOUBLE,
    AdaptationRunner,
    AdaptiveProgram,
    Exported,
    ExportError,
    Runner,
    adaptation_runner,
    adaptive_files,
    export,
    fmu_runner,
    learning_fmu,
    lower,
    write_files,
)
from jaxnarx.files import TemporaryFolder
from jaxnarx.linear._adapt import adapt
from jaxnarx.linear.adapt_program import make_plan
from jaxnarx.models import Network, looks_back
from jaxnarx.settings import Recursive
from jaxnarx.simulation import make_masks, match_records

TOLERANCE = 1e-9
"""Largest difference of a coefficient, in shares of the largest of its output."""


@guard_arguments
def export_adaptation(
    network: Network,
    data: Dataset,
    method: Recursive | None = None,
    *,
    name: str = "model",
    to: Sequence[str] = ("c",),
) -> Exported:
    """Export the network as C99, or FMU, that goes on learning as `adapt` does.

    Beside the header, source and self-test of `jnx.export` stand `NAME_adapt.h` and
    `NAME_adapt.c`: `NAME_adapt(&a, u, y, &out)` in place of `NAME_step` takes the
    measured outputs as well, NaN where one is missing, from the first sample on. It
    reports what `NAME_step` would from a free run, or with `regressors="measured"` from
    the measured outputs before; `a.learn = 0` makes it stop learning. Memory and
    multiplications stand in the header. It is compiled, and its coefficients behind
    every record of `data` are compared with those of `adapt`; `ExportError` where one
    differs by more than 1e-9 of its output's largest.

    An FMU has the measured outputs as inputs `measured.NAME` (NaN where one is
    missing; to be connected while it does not learn, too), an input `learn`, 1 while it
    is to learn, and the outputs `rmse.NAME`, `rmse_start.NAME`, `drift.NAME` and
    `undone.NAME` of the last window. What it has learnt is a part of its state, which
    is got, set and serialised. Its reported outputs are compared with those of the C.

    Args:
        network: The model, as `adapt` takes it, with one group of local models for
            every output (no sum of models).
        data: Records for the proof. Those count that have at least one `window` and
            begin with a complete history.
        method: The settings of `adapt`.
        name: Name of the files and their functions.
        to: `"c"`, `"fmu2"`, `"fmu3"`; the C files are there in any case.

    Returns:
        The files, for double precision; `difference` has that of the coefficients as
        `"c, adaptation"`, and of the outputs of an FMU, in trained ranges, as
        `"fmu3, adaptation"`; `program` is that of the model alone.

    Example:
        found = jnx.linear.export_adaptation(network, data, name="NOx")
        print(found.files["NOx_adapt.h"])
    """
    network.require_measured("Adaptation")
    network.require_no_roots("Adaptation")
    method = Recursive() if method is None else method
    for output, model in zip(network.output_names, network.models, strict=True):
        if model.own is not None:
            raise SpecError(
                f"the model of {output} is a sum of models that each have their own "
                "past outputs; C adapts single models: identify(preset='ecu') finds "
                "one",
                field="network",
            )
    _require_terms(network)
    unknown = sorted(set(to) - {"c", *FMI_VERSIONS})
    require(
        not unknown,
        "to",
        f"to holds {', '.join(map(repr, unknown))}; what learns is written as c, fmu2 "
        "or fmu3",
    )
    records = _whole_records(network, match_records(network, data), method)
    found = export(network, data, to=["c"], name=name, precision=ONLY_DOUBLE)
    adaptive = adaptive_program(network, method, name)
    files = adaptive_files(adaptive)
    code = {**found.files, **files}
    difference = dict(found.difference)
    with TemporaryFolder() as place:
        write_files(Path(place), code)
        run = adaptation_runner(Path(place), adaptive)
        every = [_difference(network, method, adaptive, run, one) for one in records]
        difference["c, adaptation"] = _require_small(
            every,
            "coefficients that the C has learnt differ from those of adapt, as shares "
            "of the largest,",
        )
        for target in [name for name in FMI_VERSIONS if name in to]:
            version = FMI_VERSIONS[target]
            made = learning_fmu(found.program, code, version)
            write_files(Path(place), made)
            other = fmu_runner(Path(place), found.program, version, learns=True)
            if other is not None:
                every = [_outputs_apart(adaptive, run, other, one) for one in records]
                difference[f"{target}, adaptation"] = _require_small(
                    every,
                    "outputs of the FMU that learns differ from those of the C, as "
                    "shares of their range,",
                )
            files |= made
    return dataclasses.replace(
        found, files={**found.files, **files}, difference=difference
    )


def adaptive_program(network: Network, method: Recursive, name: str) -> AdaptiveProgram:
    """What is to learn, as exports take it."""
    chosen = []
    for model, own in zip(
        network.models, make_plan(network, method).chosen, strict=True
    ):
        active = np.flatnonzero(np.asarray(model.active)).tolist()
        chosen.append(tuple(active.index(m) for m in own))
    program = lower(network, name, learnable=True)
    past = method.regressors if looks_back(network) else "none"
    return AdaptiveProgram(program, method, past, tuple(chosen))


def _require_terms(network: Network) -> None:
    """SpecError where a coefficient is zero: exports leave its term out."""
    for name, model in zip(network.output_names, network.models, strict=True):
        active = np.flatnonzero(np.asarray(model.active))
        slots = np.asarray(model.local.used)[active].sum(axis=1)
        terms = np.count_nonzero(np.asarray(model.local.dense())[active], axis=1)
        wrong = np.flatnonzero(slots != terms)
        if len(wrong):
            raise SpecError(
                f"local model {active[wrong[0]] + 1} of {name} has "
                f"{slots[wrong[0]]} coefficients for {terms[wrong[0]]} terms: one is "
                "zero, or two are of one term. C has no place for these; take the term "
                "out, or adapt the network over some records first",
                field="network",
            )


def _whole_records(network: Network, data: Dataset, method: Recursive) -> list[Dataset]:
    """Records one by one, as far as their whole windows go, for a control unit has no
    last sample after which a part of one is judged; those that begin with a complete
    history, as every proof of an export needs."""
    begun = make_masks(network, stack_records(data)).start == network.history
    window, found = method.window, []
    for record, whole in zip(data, begun, strict=True):
        count = len(record) - len(record) % window
        if whole and count > network.history:
            part = dataclasses.replace(data, records=(record.part(0, count),))
            found.append(part)
    if not found:
        longest = max(len(record) for record in data)
        raise DataError(
            f"the proof needs a record that begins with {network.history} complete "
            f"samples and has at least one window of {window} samples; the longest has "
            f"{longest}"
        )
    return found


def _difference(
    network: Network,
    method: Recursive,
    adaptive: AdaptiveProgram,
    run: AdaptationRunner,
    data: Dataset,
) -> float:
    """The largest difference of a coefficient behind a record."""
    program = adaptive.program
    expected = lower(adapt(network, data, method).value, program.name)
    found, _ = run(*_measured(adaptive, data))
    differences, at = [], 0
    for part in adaptive.parts:
        theta = expected.table(part.table).values.ravel()
        own = found[at : at + theta.size]
        differences.append(np.max(np.abs(own - theta)) / np.max(np.abs(theta)))
        at += theta.size
    return float(np.max(differences))


def _measured(adaptive: AdaptiveProgram, data: Dataset) -> tuple[np.ndarray, ...]:
    """Inputs and outputs of the record, NaN where there is none."""
    program, names = adaptive.program, data.channels.names
    (record,) = data.records
    seen = np.where(record.valid, record.signals, np.nan)
    ports = program.inputs, program.computed
    inputs, outputs = (seen[:, [names.index(p.name) for p in own]] for own in ports)
    return inputs, outputs


def _outputs_apart(
    adaptive: AdaptiveProgram, run: AdaptationRunner, other: Runner, data: Dataset
) -> float:
    """The largest difference of what C and FMU report, in trained ranges."""
    program, measured = adaptive.program, _measured(adaptive, data)
    _, expected = run(*measured)
    width = np.array([port.high - port.low for port in program.reported])
    found = other(*measured)
    apart = np.abs(found - expected) / np.where(width > 0, width, 1.0)
    apart = np.where(np.isnan(found) & np.isnan(expected), 0.0, apart)
    return float(np.max(apart[program.history :]))


def _require_small(differences: Sequence[float], what: str) -> float:
    """The largest of them; ExportError where it is too large."""
    worst = float(np.max(differences))
    if not worst <= TOLERANCE:
        raise ExportError(f"{what} by {worst:.3g}, more than {TOLERANCE:g}")
    return worst
