"""The commands and their flags. No jax here: `--help` answers at once.

Each command is a frozen dataclass; its docstring and those of its fields are the help.
The work is done by `jaxnarx.shell.work`, imported when a command runs.
"""

import dataclasses
import inspect
import re
from typing import Annotated, Literal, get_args

from tyro.conf import Positional, arg

from jaxnarx.methods import (
    ForwardOLS,
    Identification,
    Polynomial,
    SimulationError,
)
from jaxnarx.methods.description import DESCRIPTION
from jaxnarx.shell.annotations import (
    Description,
    Flag,
    Folder,
    Model,
    Names,
    Needed,
    Outside,
    Percent,
    Whole,
    optional,
)
from jaxnarx.shell.search_commands import Automatic, Leaderboard, Take


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
    validate and test; `jaxnarx check --help` shows one. Candidates from linear models
    to many regions are tried and judged by their free run over groups of records left
    out; the cheapest within one standard error of the best is trained on all records,
    those for validation among them. Ctrl-C ends the search with the best so far, and
    the same command goes on where it stopped; `jaxnarx leaderboard` shows all
    candidates, `jaxnarx take` trains another one. Settings of a method (all options
    from --input-lags to --hold-out) make this one method, without a search. The last
    lines are a verdict (good, usable with limits, or not usable, and why) and the
    command that would help.

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
class Simulate:
    """Run a model freely on new files and write its outputs.

    FILE holds columns named like the model's channels, in any order, at the model's
    sample time; or it is one TOML description. Measured outputs are needed in
    the first rows only, which the run starts from; later cells may be empty.

    Example:
        jaxnarx simulate runs/demo/model.safetensors new_run.csv --out simulated
    """

    model: Positional[Model]
    """Model file."""
    files: Positional[Annotated[tuple[str, ...], arg(metavar="FILE [FILE ...]")]]
    """Data files, or one TOML description."""
    steps: Annotated[int | None, optional("INT")] = None
    """Predict this many steps ahead instead of running freely."""
    root: Folder = None
    """Folder of the data of a description; default as for `jaxnarx report`."""
    out: Annotated[str, arg(metavar="FOLDER")] = "simulated"
    """Folder for the files."""
    level: Annotated[float | None, optional("P")] = None
    """Add columns with the interval that is to hold this share of what is measured, .5
    to .99, around each output. For models that know their errors, as of `identify`."""
    format: Literal["csv", "parquet", "mat", "mf4"] = "csv"
    """Of the files that are written; with units where the format has them."""
    through: Annotated[str | None, optional("MODEL")] = None
    """MODEL is an inverse: run this model of the engine under its commands. The columns
    of its outputs are then what they shall be; commands are needed in the first rows
    only."""
    prepare: Flag = False
    """Prepare raw files first as the model's training records were prepared."""
    no_limits: Flag = False
    """Hold neither inputs nor outputs to their trained ranges, whatever MODEL says."""
    outside: Outside = None
    """What inputs do beyond their trained ranges: nothing, stay at the edge, or go on
    from there to first order; default: as MODEL says."""
    force: Flag = False
    """Overwrite files of an earlier run."""


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


@dataclasses.dataclass(frozen=True)
class Report:
    """Score a model on described records: one step, ten steps and free run.

    The first line is the verdict: good, usable with limits, or not usable, and why.

    Example:
        jaxnarx report runs/demo/model.safetensors engine.toml --out runs/check
    """

    model: Positional[Model]
    """Model file."""
    description: Positional[Description]
    """TOML description of the records."""
    root: Folder = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    out: Folder = None
    """Folder for report.html and report.json; default: only print."""
    beside: Annotated[tuple[str, ...], optional("MODEL [MODEL ...]")] = ()
    """Other models to compare with on the same records, in free run."""
    over: Annotated[tuple[str, ...], optional("NAME NAME")] = ()
    """Two channels over which the error is mapped, lagged ones as 'speed[t-1]';
    default: the two that schedule most."""
    no_limits: Flag = False
    """Hold neither inputs nor outputs to their trained ranges, whatever MODEL says."""
    outside: Outside = None
    """What inputs do beyond their trained ranges: nothing, stay at the edge, or go on
    from there to first order; default: as MODEL says."""
    force: Flag = False
    """Overwrite an earlier report."""
    require_fit: Percent = None
    """Exit with 1 unless the pooled free-run fit of every output reaches this [%]."""


@dataclasses.dataclass(frozen=True)
class Describe:
    """Look into measurement files and write the description that other commands read.

    FILE is CSV, Parquet, a spreadsheet, MDF, MATLAB, HDF5 or npz, or a folder of them.
    Channels with units and ranges, layout and sample time are found out, inputs and
    outputs guessed from names and courses with the reason beside each, files that
    repeat one cycle tied together, and records for training and test proposed.

    Example:
        jaxnarx describe measurements --outputs NOx T_exhaust
    """

    files: Positional[Annotated[tuple[str, ...], arg(metavar="FILE [FILE ...]")]]
    """Measurement files, or folders of them."""
    outputs: Names = ()
    """Channels to be modelled; default: guessed."""
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

    Reports constants, duplicates, gaps, saturation, spikes, excitation, dead time and
    feedback, and suggests lags.

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
class Export:
    """Write a model as source files for another program, proven to do the same.

    c is C99 with one header, one source and a self-test, without heap and with `exp` of
    math.h alone, in double or single precision; fmu2 and fmu3 are units of FMI 2.0 and
    3.0 for co-simulation, binary for this machine and source for others; python and
    javascript are files of one page without dependencies; matlab is a function that
    keeps its state, for a MATLAB Function block or Octave, and a test of it. Every one
    is compiled where it must be and run over the records of FILE, without any over
    steps within the trained ranges, beside the model; one that differs is not written.
    For calibration, dcm (DCM 2.0) holds the parameters and maps of every output at rest
    over two inputs, with the others in the middle of their trained ranges, `jaxnarx
    import-dcm` takes it back; a2l (1.71) links names to the symbols of c, so that a
    tool finds their addresses. README.md says what was found: differences, operations,
    parameters, memory, and how to call it.

    Example:
        jaxnarx export runs/engine-good/model.safetensors engine.toml --to c python
    """

    model: Positional[Model]
    """Model file."""
    files: Positional[Annotated[tuple[str, ...], arg(metavar="[FILE ...]")]] = ()
    """Data files, or one TOML description, for the proof."""
    to: Annotated[
        tuple[
            Literal[
                "c", "fmu2", "fmu3", "python", "javascript", "matlab", "dcm", "a2l"
            ],
            ...,
        ],
        arg(),
    ] = ("c",)
    """What is written."""
    over: Annotated[tuple[str, ...], optional("NAME NAME")] = ()
    """The two inputs of the maps of dcm; default: of each output the inputs that
    schedule it, then those that move it most at rest."""
    name: str = "model"
    """What files and functions are called."""
    root: Folder = None
    """Folder of the data of a description; default as for `jaxnarx report`."""
    out: Annotated[str, arg(metavar="FOLDER")] = "export"
    """Folder for the files."""
    level: Annotated[float | None, optional("SHARE")] = None
    """Tell half of the prediction interval of this probability as well, such as 0.9."""
    without_index: Flag = False
    """Leave out the index of the model's domain, which takes most of the operations of
    a small model."""
    unproven: Flag = False
    """Write without the proof."""
    force: Flag = False
    """Overwrite files of an earlier export."""


@dataclasses.dataclass(frozen=True)
class ImportDcm:
    """Take changed parameters of an exported model back into it.

    FILE is the DCM 2.0 file, or the C source, that `jaxnarx export` has written of
    MODEL, with numbers changed: coefficients, centres, widths, borders, gates and
    scalings. Blocks may be left out; a block that is none of the model's, of another
    size, or with anything but finite numbers is an error that names its line. Only
    numbers that differ are taken. The new model has no prediction intervals any more,
    and a certificate of stability only where one is found for the new numbers;
    `jaxnarx report` tells what it is worth.

    Example:
        jaxnarx import-dcm runs/engine-good/model.safetensors changed.dcm --out changed
    """

    model: Positional[Model]
    """Model file that was exported."""
    file: Positional[Annotated[str, arg(metavar="FILE")]]
    """DCM file or C source with changed numbers."""
    out: Annotated[str, arg(metavar="FOLDER")] = "imported"
    """Folder for the new model.safetensors."""
    force: Flag = False
    """Write into a folder that already holds a model."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """Plan the next test: the record that tells most about a model's free run.

    Steps of all inputs, chosen through the model, from the middle of what it knows
    outwards, within ranges, rates, forbidden combinations and limits of its outputs,
    which its prediction intervals keep clear of. FOLDER receives plan.csv, one row per
    sample, plan.toml, which describes it, and predicted.csv, what the model makes of
    it. Output columns of plan.csv are filled in the first rows only, so that `jaxnarx
    simulate` can begin; a test bench has no use for them.

    Example:
        jaxnarx plan runs/engine/model.safetensors --duration 20min
        --range speed=800:4000 --rate speed=200 --forbid "speed > 3000 & load < 5"
        --limit T_exhaust=900
    """

    model: Positional[Model]
    """Model file; it must know its domain, as what `jaxnarx identify` finds does."""
    duration: Annotated[str, arg(metavar="TIME")]
    """Length of the test: 90s, 20min, 1h."""
    range: Annotated[tuple[str, ...], optional("NAME=LOW:HIGH [...]")] = ()
    """Ranges of inputs; default: those of the training."""
    rate: Annotated[tuple[str, ...], optional("NAME=RATE [...]")] = ()
    """Largest change of inputs, in their unit per second; default: that of the
    training from sample to sample."""
    forbid: Annotated[tuple[str, ...], optional("COMPARISONS [...]")] = ()
    """Combinations of inputs that must not be, each as "speed > 3000 & load < 5"."""
    limit: Annotated[tuple[str, ...], optional("NAME=HIGHEST [...]")] = ()
    """Limits of modelled outputs; NAME=LOWEST:HIGHEST for both."""
    hold: Annotated[tuple[str, str] | None, optional("SHORTEST LONGEST")] = None
    """Times between which inputs keep a level, such as 0.5s 5s; default: half and four
    times the model's memory, which parts of the engine it has not seen may exceed."""
    seed: int = 0
    """Seed of the random stretches that the plan is chosen from."""
    out: Annotated[str, arg(metavar="FOLDER")] = "plan"
    """Folder for the files."""
    force: Flag = False
    """Overwrite files of an earlier plan."""


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


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Identify many engines under many settings, in a folder that can be continued.

    The description (TOML) names engines, the identification and the cases. Every
    finished chunk is a file of the run folder: give the same command again to continue
    a sweep that was stopped, or run it in several terminals at once to share the work.
    A fit that fails is a row with its status. The rows are table.parquet and table.csv.

    Example:
        jaxnarx sweep ridge.toml --folder runs/ridge --workers 2

    A small description, ridge.toml:
        [data]
        bed = "pfi-dyno"
        count = 16
        spread = 0.05
        [identification.pool]
        outputs = ["MAP"]
        [identification.grow]
        method = "lolimot"
        scheduling = ["speed[t]"]
        [cases]
        refine.ridge = [1e-6, 1e-4]
        refine.train = ["coefficients", "joint"]

    In place of bed: engines = ["engines/*.toml"], descriptions of measured ones. In
    place of [cases]: [random] with count, seed and ranges as ["log", 1e-6, 1e-2]. The
    sections of [identification] are those of `jaxnarx identify --settings`.
    """

    description: Positional[Description]
    """TOML description of the sweep."""
    folder: Folder = None
    """Run folder; default: runs/ and the description's name."""
    workers: int = 1
    """Processes, each on a core of its own."""
    chunk: int = 32
    """Fits of a chunk; what is in flight when the sweep stops is lost."""
    new_run: Flag = False
    """Begin anew; an earlier sweep in the folder is set aside, not removed."""


def _kebab(name: str) -> str:
    """A class name as it is typed: `SimulateEngine` is `simulate-engine`."""
    return re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower()


Command = (
    Demo
    | Identify
    | Leaderboard
    | Take
    | Simulate
    | Invert
    | Report
    | Describe
    | Check
    | Export
    | ImportDcm
    | Plan
    | Prepare
    | SimulateEngine
    | Sweep
)
_RECORDS = (Identify, Invert, Report, Check, Prepare)


def help_of(command: type) -> str:
    """What help says of a command; where it reads records, with their description."""
    text = inspect.getdoc(command) or ""
    return f"{text}\n\n{DESCRIPTION}" if command in _RECORDS else text


COMMANDS: dict[str, type] = {_kebab(c.__name__): c for c in get_args(Command)}
