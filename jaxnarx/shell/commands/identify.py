"""Commands that make a model: demo, identify, invert. No jax here."""

import dataclasses
from typing import Annotated

from tyro.conf import Positional

from jaxnarx.settings import ForwardOLS, Identification, Polynomial, SimulationError
from jaxnarx.shell.commands.annotations import (
    Description,
    Flag,
    Folder,
    Model,
    Names,
    Needed,
    Percent,
    Whole,
    optional,
)
from jaxnarx.shell.commands.search import Automatic


@dataclasses.dataclass(frozen=True)
class Demo:
    """Identify a virtual engine, from duty cycle to speed, and write the report.

    Simulates the port-injected engine test bed, chooses terms, divides the operating
    space into up to four local models, refines them together with the partition on
    simulation error, and reports on a record that took no part. Needs no files.

    Example:
        jaxnarx demo --out runs/first
    """

    out: Folder = None
    """Folder for model and report; default: a new one under runs/."""
    models: int = 4
    """Largest number of local models."""
    events: int = 2000
    """Length of each of the three records, in events of 180 degrees."""
    seed: int = 1
    """Seed of the excitation signals and the measurement noise."""
    force: Flag = False
    """Write into a folder that already holds a model."""


@dataclasses.dataclass(frozen=True)
class Identify:
    """Identify a model from measured records and write model and report.

    The description (TOML) names files, channels, units and which records train,
    validate and test. Candidates from linear models to many regions are tried and
    judged by their free run over groups of records left out; the cheapest within one
    standard error of the best is trained on all records, those for validation among
    them. The last lines are a verdict (good, usable with limits, or not usable, and
    why) and the command that would help.

    Ctrl-C ends the search with the best so far, and the same command goes on where it
    stopped; `jaxnarx leaderboard` shows all candidates, `jaxnarx choose` trains another
    one. Settings of a method (all options from --input-lags to --hold-out) make this
    one method, without a search.

    Example:
        jaxnarx identify engine.toml

    One method:
        jaxnarx identify engine.toml --output NOx --models 6 --schedule "speed[t]"
    """

    description: Positional[Description]
    """TOML description of the records."""
    method: Automatic | Identification = Automatic()
    """How it is identified: a search, or one method; the options of both."""
    hold_out: Annotated[float | None, optional("SHARE")] = None
    """One method: share of the training samples that validates, where no record is
    named for it; default 0.2."""
    root: Folder = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    out: Folder = None
    """Folder for model and report; default: one under runs/, a new one for one method,
    always the same for a search."""
    force: Flag = False
    """Write into a folder that already holds a model; a search begins anew."""
    require_fit: Percent = None
    """Exit with 1 unless the pooled free-run fit of every output reaches this [%]."""


@dataclasses.dataclass(frozen=True)
class Invert:
    """Identify the inverse of a model: from wanted outputs to the commands for them.

    Reads the described records backwards for a first inverse, says where the model
    cannot be inverted, and trains the inverse through the model on what the two of them
    do to a reference (thesis section 7.3). FOLDER receives inverse.safetensors,
    report.html about the inverse by itself, and tracking.json and tracking.png about
    the two in a row. Targets are seen ahead by the model's dead time.

    Example:
        jaxnarx invert runs/car/model.safetensors car.toml --command THR SA --target TRQ

    Then run both:
        jaxnarx simulate runs/inverse/inverse.safetensors wanted.csv
        --through runs/car/model.safetensors
    """

    model: Positional[Model]
    """Model file of the engine."""
    description: Positional[Description]
    """TOML description of the records."""
    command: Needed
    """Inputs of the model that the inverse computes."""
    target: Names = ()
    """Outputs of the model that shall be followed; default: all."""
    state: Names = ()
    """Further measured outputs that the inverse may use, at lags of 1 or more."""
    lead: Whole = None
    """Samples by which targets are seen ahead; default: the model's dead times."""
    method: Identification = Identification(
        pool=Polynomial(input_lags=(0, 1, 2, 4), output_lags=(1,)),
        select=ForwardOLS(max_terms=20),
        refine=SimulationError(horizons=(10, 30, 100), max_steps=20, window_steps=10),
    )
    """The inverse by itself, before it is trained through the model: input lags are
    those of everything that it sees, output lags those of its own commands."""
    steps: int = 40
    """Training steps through the model; 0 keeps the direct inverse."""
    effort: float = 1e-3
    """Price of moving the commands beside the tracking error."""
    range: Annotated[tuple[str, ...], optional("NAME=LOW:HIGH [...]")] = ()
    """Limits of commands; default: their ranges in training, a little widened."""
    rate: Annotated[tuple[str, ...], optional("NAME=RATE [...]")] = ()
    """Largest change of commands, in their unit per second."""
    hold_out: float = 0.2
    """Share of the training samples that validates, where no record is named for it."""
    root: Folder = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    out: Folder = None
    """Folder for the files; default: a new one under runs/."""
    force: Flag = False
    """Write into a folder that already holds an inverse."""
