"""The verb `export_adaptation`: C of a model that learns while it runs, proven."""

import dataclasses
from pathlib import Path

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.exporters import (
    AdaptationRunner,
    Adaptive,
    Exported,
    ExportError,
    adaptation_runner,
    adaptive_files,
    export,
    lower,
    write_files,
)
from jaxnarx.files import TemporaryFolder
from jaxnarx.linear._adapt import adapt
from jaxnarx.linear.adapt_program import make_plan
from jaxnarx.models import Network
from jaxnarx.settings import Recursive
from jaxnarx.simulation import match_records

TOLERANCE = 1e-9
"""Largest difference of a coefficient, in shares of the largest of its output."""


@guard_arguments
def export_adaptation(
    network: Network,
    data: Dataset,
    method: Recursive | None = None,
    *,
    name: str = "model",
) -> Exported:
    """Export the network as C99 that goes on learning as `adapt` does.

    Beside the header, source and self-test of `jnx.export` stand `NAME_adapt.h` and
    `NAME_adapt.c`: `NAME_adapt(&a, u, y, &out)` in place of `NAME_step` takes the
    measured outputs as well, NaN where one is missing, and reports what `NAME_step`
    would. Memory and multiplications stand in the header. It is compiled, and its
    coefficients behind every record of `data` are compared with those of `adapt`;
    `ExportError` where one differs by more than 1e-9 of its output's largest.

    Args:
        network: The model, as `adapt` takes it, with one group of local models for
            every output (no sum of models).
        data: Records for the proof, of at least one `window`.
        method: The settings of `adapt`.
        name: Name of the files and their functions.

    Returns:
        The files; `difference` has that of the coefficients as `"c, adaptation"`.

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
    found = export(network, data, to=["c"], name=name, index=True)
    adaptive = adaptive_program(network, method, name)
    files = adaptive_files(adaptive)
    records = _whole_windows(match_records(network, data), method.window)
    with TemporaryFolder() as place:
        write_files(Path(place), {**found.files, **files})
        run = adaptation_runner(Path(place), adaptive)
        worst = max(_difference(network, method, adaptive, run, r) for r in records)
    if not worst <= TOLERANCE:
        raise ExportError(
            f"coefficients that the C has learnt differ from those of adapt by "
            f"{worst:.3g} of the largest, more than {TOLERANCE:g}"
        )
    difference = {**found.difference, "c, adaptation": worst}
    return dataclasses.replace(
        found, files={**found.files, **files}, difference=difference
    )


def adaptive_program(network: Network, method: Recursive, name: str) -> Adaptive:
    """What is to learn, as exports take it."""
    tables = [network.variables, *(m.scheduling for m in network.models)]
    fed = any(s in network.signals for table in tables for s, _ in table)
    chosen = []
    for model, own in zip(
        network.models, make_plan(network, method).chosen, strict=True
    ):
        active = np.flatnonzero(np.asarray(model.active)).tolist()
        chosen.append(tuple(active.index(m) for m in own))
    program = lower(network, name, learnable=True)
    past = method.regressors if fed else "none"
    return Adaptive(program, method, past, tuple(chosen))


def _whole_windows(data: Dataset, window: int) -> list[Dataset]:
    """Records one by one, as far as their whole windows go; a control unit has no last
    sample after which a part of one is judged."""
    records = (r.part(0, len(r) - len(r) % window) for r in data if len(r) >= window)
    found = [dataclasses.replace(data, records=(one,)) for one in records]
    if not found:
        longest = max(len(r) for r in data)
        raise DataError(
            f"the proof needs a record of at least one window of {window} samples; the "
            f"longest has {longest}"
        )
    return found


def _difference(
    network: Network,
    method: Recursive,
    adaptive: Adaptive,
    run: AdaptationRunner,
    data: Dataset,
) -> float:
    """The largest difference of a coefficient behind a record."""
    program = adaptive.program
    expected = lower(adapt(network, data, method).value, program.name)
    (record,) = data.records
    names = data.channels.names
    seen = np.where(record.valid, record.signals, np.nan)
    inputs, outputs = (
        seen[:, [names.index(port.name) for port in ports]]
        for ports in (program.inputs, program.computed)
    )
    found = run(inputs, outputs)
    worst, at = 0.0, 0
    for part in adaptive.parts:
        theta = expected.table(part.table).values.ravel()
        own = found[at : at + theta.size]
        worst = max(worst, float(np.max(np.abs(own - theta)) / np.max(np.abs(theta))))
        at += theta.size
    return worst
