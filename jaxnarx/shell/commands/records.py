"""Commands about records: describe, check, prepare, simulate them. No jax here."""

import dataclasses
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from jaxnarx.shell.commands.annotations import (
    Description,
    Flag,
    Folder,
    Names,
    Whole,
    optional,
)


@dataclasses.dataclass(frozen=True)
class Describe:
    """Look into measurement files and write the description that other commands read.

    FILE is CSV, Parquet, a spreadsheet, MDF, MATLAB, HDF5 or npz, or a folder of them.
    Channels with units and ranges, layout and sample time are found out, inputs and
    outputs guessed from names and courses with the reason beside each, files that
    repeat one cycle tied together, and records for training and test proposed: of one
    long record its beginning and end. Numbered columns (Input1, Output1, Input2, ...)
    become records. A record that seems to be in another unit than the others is told.

    Example:
        jaxnarx describe measurements --outputs NOx T_exhaust
    """

    files: Positional[Annotated[tuple[str, ...], optional("FILE [FILE ...]")]]
    """Measurement files, or folders of them."""
    outputs: Names = ()
    """Channels to be modelled, all others being inputs; default: guessed."""
    inputs: Names = ()
    """Channels that move the engine; default: guessed."""
    columns: Names = ()
    """Names of all columns in order, for CSV files without a header."""
    table: Annotated[str | None, optional("NAME")] = None
    """Sheet, variable or group, where files hold several."""
    sample_time: Annotated[float | None, optional("SECONDS")] = None
    """Where the files do not tell it, or to bring several rasters to it."""
    out: Annotated[str, arg(metavar="FILE")] = "engine.toml"
    """The description to be written."""
    force: Flag = False
    """Overwrite it."""


@dataclasses.dataclass(frozen=True)
class Check:
    """Look at data before anything is fitted: what may spoil a model, and which lags.

    Reports constants, duplicates, gaps, saturation, spikes, records in another unit
    than the others, excitation, dead time and feedback, and suggests lags.

    Example:
        jaxnarx check engine.toml
        jaxnarx check new_records.toml --model runs/demo/model.safetensors

    The smallest description, engine.toml:
        [data]
        sample_time = 0.1
        [channels.inputs]
        speed = "rpm"
        [channels.outputs]
        NOx = "ppm"
        [records]
        train = ["day1_*.csv"]
        test = ["day2_*.csv"]
    """

    description: Positional[Description]
    """TOML description of the records."""
    root: Folder = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    model: Annotated[str | None, optional("MODEL")] = None
    """Tell instead how far the records leave what this model knows, and where."""
    json: Flag = False
    """Print the findings as JSON."""


@dataclasses.dataclass(frozen=True)
class Prepare:
    """Prepare measured records: outliers, drift, filter, sample time, offset, scale.

    Every step is fitted to the training records (to all, where none are named) and
    applied to all of them. Whichever are asked for, they are done in the order of the
    options below. FOLDER receives a CSV file per record, whose empty cells are masked
    samples, prepared.toml, which describes them with the same division into train,
    validate and test, and preparation.json, with every number of every step; a model
    identified from prepared.toml keeps it, for `jaxnarx simulate --prepare`.

    Example:
        jaxnarx prepare engine.toml --out prepared --hampel 7 --low-pass 2 --decimate 2
    """

    description: Positional[Description]
    """TOML description of the records."""
    out: Annotated[str, arg(metavar="FOLDER")] = "prepared"
    """Folder for the prepared files."""
    hampel: Whole = None
    """Mask outliers: half width, in samples, of the window they are sought in."""
    detrend: Flag = False
    """Remove each record's linear drift; its level stays."""
    low_pass: Annotated[float | None, optional("HZ")] = None
    """Filter without phase; cut-off, where the amplitude is halved [Hz]."""
    decimate: Whole = None
    """Keep one of this many samples, after an anti-aliasing filter."""
    resample: Annotated[float | None, optional("SECONDS")] = None
    """New sample time [s], anti-aliased where it is longer."""
    offset: Annotated[Literal["mean", "first"] | None, optional("{mean,first}")] = None
    """Subtract from every channel its mean, or its first sample."""
    scale: Annotated[
        Literal["min-max", "mean", "standard"] | None,
        optional("{min-max,mean,standard}"),
    ] = None
    """Scale every channel: to [0, 1], by its mean, or to unit variance."""
    root: Folder = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    force: Flag = False
    """Overwrite files of an earlier run."""


@dataclasses.dataclass(frozen=True)
class SimulateEngine:
    """Simulate a virtual engine and write its records, ready to be identified.

    FOLDER receives a CSV file per record, engine.toml, which describes them, and
    excitation.png: inputs and outputs over time, their spectra, and which cells of the
    operating space are visited. Samples beyond a limit (smoke, surge, mixture ...) are
    told and marked in columns of their own. Beds sampled by crank angle have one row
    per event, unless --sample-time is given.

    Example:
        jaxnarx simulate-engine diesel --signal aprbs --duration 600 --out runs/diesel
    """

    engine: Positional[Literal["pfi", "pfi-dyno", "pfi-cc", "diesel", "gtdi", "vct"]]
    """The bed: port-injected (free speed, on a dynamometer, compact variant), diesel
    with EGR and VGT, turbocharged direct injection, variable cam timing."""
    signal: Literal["aprbs", "prbs", "random-walk", "multisine", "chirp", "steps"] = (
        "aprbs"
    )
    """aprbs moves all inputs as is usual for the bed; the others move one of them, the
    rest stays at a usual operating point."""
    input: Annotated[str | None, optional("NAME")] = None
    """The input that is moved; default: the first."""
    duration: float = 300.0
    """Length of every record [s]; nominal where events are sampled."""
    records: int = 3
    """Number of records; of three or more the last two validate and test."""
    hold: int = 20
    """Samples for which prbs and random-walk hold a level; the highest frequency of
    multisine and chirp is that of twice as many."""
    sample_time: Annotated[float | None, optional("SECONDS")] = None
    """Resample records of crank-angle events to this time."""
    noise: float = 1.0
    """Measurement noise as a multiple of the bed's own; 0 for none."""
    spread: float = 0.0
    """Simulate a random relative of the engine, its parameters off by about this."""
    seed: int = 1
    """Seed of signals, noise and relative."""
    out: Annotated[str, arg(metavar="FOLDER")] = "runs/engine"
    """Folder for the files."""
    force: Flag = False
    """Overwrite files of an earlier run."""
