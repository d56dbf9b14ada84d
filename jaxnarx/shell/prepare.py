"""Prepared records: written as files, and made again of new ones."""

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxnarx.data import (
    AbstractStep,
    Channels,
    Dataset,
    Decimate,
    Detrend,
    Hampel,
    LowPass,
    Preparation,
    RemoveOffset,
    Resample,
    Scale,
    Split,
    match_channels,
    prepare,
)
from jaxnarx.errors import ModelFileError, SpecError
from jaxnarx.shell.commands import Prepare
from jaxnarx.shell.messages import count, say, warn
from jaxnarx.shell.output import (
    file_names,
    run_folder,
    write_text,
    write_together,
)
from jaxnarx.shell.record_files import describe, record_csv

DESCRIPTION_FILE, PREPARATION_FILE = "prepared.toml", "preparation.json"

_SETTING_OPTIONS = {
    "half_width": "--hampel",
    "cutoff": "--low-pass",
    "factor": "--decimate",
    "sample_time": "--resample",
}
"""Settings by the name the library has for them."""


def make_steps(command: Prepare) -> list[AbstractStep]:
    """The steps that the flags ask for, in their fixed order.

    Outliers first, for they spoil every mean and filter; offset and scale last, for
    they belong to the data that the model sees.
    """
    steps: list[AbstractStep] = []
    try:
        if command.hampel is not None:
            steps.append(Hampel(half_width=command.hampel))
        if command.detrend:
            steps.append(Detrend())
        if command.low_pass is not None:
            steps.append(LowPass(cutoff=command.low_pass))
        if command.decimate is not None:
            steps.append(Decimate(factor=command.decimate))
        if command.resample is not None:
            steps.append(Resample(sample_time=command.resample))
        if command.offset is not None:
            steps.append(RemoveOffset(kind=command.offset))
        if command.scale is not None:
            steps.append(Scale(kind=command.scale))
    except SpecError as error:
        raise _name_option(error) from error
    if not steps:
        raise SpecError(
            "prepare has nothing to do; give at least one step, such as --decimate 2 "
            "(`jaxnarx prepare --help` lists them)"
        )
    return steps


def _name_option(error: SpecError) -> SpecError:
    """The error with the option that was typed in place of the library's setting."""
    field = error.field or ""
    flag = _SETTING_OPTIONS.get(field)
    return SpecError(re.sub(rf"^{field}\b", flag, str(error)) if flag else str(error))


def write_prepared(
    split: Split, steps: Sequence[AbstractStep], out: str, *, force: bool
) -> Path:
    """Fit to the training records, prepare all, write them; returns the description.

    Nothing is written unless every record can be prepared.
    """
    named = {"train": split.train, "validate": split.validate, "test": split.test}
    parts = {k: v for k, v in named.items() if v is not None} or {"files": split.all}
    fitted_to = parts.get("train", split.all)
    if split.at_rest is not None:
        warn("operating points at rest are not prepared, nor named by what is written")
    say(
        f"Fitted to {count(len(fitted_to), 'record')}, "
        f"{count(fitted_to.samples, 'sample')}"
        + (" for training" if "train" in parts else ": all that are described")
    )
    try:
        _, preparation = prepare(fitted_to, steps)
        done, report = preparation.apply_reported(split.all)
    except SpecError as error:
        raise _name_option(error) from error
    say(str(report))
    if split.preparation is not None:
        preparation = preparation.prepend(split.preparation)
    names = file_names(done.names)
    texts = {name: record_csv(done, n) for n, name in enumerate(names)}
    lengths = [len(data) for data in parts.values()]
    starts = np.cumsum([0, *lengths]).tolist()
    of = {p: names[a : a + n] for p, a, n in zip(parts, starts, lengths, strict=False)}
    made = {"preparation": PREPARATION_FILE}
    texts[DESCRIPTION_FILE] = describe(
        done, of, by="jaxnarx prepare", extra=made, physics=split.physics
    )
    kept = preparation.to_dict()
    texts[PREPARATION_FILE] = json.dumps(kept, allow_nan=False, indent=1)
    with run_folder(out, "", force=force, marks=list(texts)) as folder:
        with write_together(folder) as place:
            for name, text in texts.items():
                write_text(place / name, text)
    say(
        f"\nwrote {count(len(names), 'record')} at {done.sample_time:g} s, "
        f"{DESCRIPTION_FILE} and {PREPARATION_FILE} to {folder}"
    )
    return folder / DESCRIPTION_FILE


def stored_preparation(model: str | os.PathLike[str]) -> Preparation | None:
    """The preparation of a model's training records, None where there was none."""
    from jaxnarx.models import load_about

    table = load_about(model).get("preparation")
    if table is None:
        return None
    try:
        return Preparation.from_dict(table)
    except SpecError as error:
        raise ModelFileError(
            f"{model}: its preparation cannot be read: {error}", path=model
        ) from error


def raw_channels(preparation: Preparation, channels: Channels) -> Channels:
    """The channels that raw files must hold for a model with these, in raw units.

    Channels that only a step needs (a speed to count crank angle by) become inputs.
    """
    raw = {c.name: c for c in preparation.channels.all}
    needs = [n for n in preparation.needs if n not in channels.names]
    try:
        return Channels(
            tuple(raw[n] for n in [*channels.input_names, *needs]),
            tuple(raw[n] for n in channels.output_names),
        )
    except KeyError as error:
        raise ModelFileError(
            f"the model has a channel {error} that its preparation does not know"
        ) from error


def prepare_like_training(
    preparation: Preparation, raw: Dataset, channels: Channels
) -> Dataset:
    """Raw records as the model saw its training records, with its channels."""
    data, report = preparation.apply_reported(raw)
    data = match_channels(data, channels)[0]
    labels = ", ".join(c.label for c in data.channels.outputs)
    say(f"{report}\nOutputs are those of the prepared records: {labels}")
    return data
