"""Commands about a model: run, judge and export it, plan its next test. No jax here."""

import dataclasses
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from jaxnarx.shell.commands.annotations import (
    Description,
    Flag,
    Folder,
    Model,
    Outside,
    Percent,
    optional,
)


@dataclasses.dataclass(frozen=True)
class Simulate:
    """Run a model freely on new files and write its outputs.

    FILE holds columns named like the model's channels, in any order, at the model's
    sample time; or it is one TOML description. Measured outputs are needed in
    the first rows only, which the run starts from; later cells may be empty. Where
    they are not, the free run is scored against them.

    FOLDER receives a file per record. Its columns for every output: simulated (with
    --steps, predicted), measured, limited (1 where the model's bound held the run),
    held (1 where the output stands at the edge of its trained range) and, with --level,
    lower and upper; then extrapolated (1 where an input is outside its trained range)
    and, of models that know their domain, index (above 1: outside).

    Example:
        jaxnarx simulate runs/demo/model.safetensors new_run.csv --out simulated
    """

    model: Positional[Model]
    """Model file."""
    files: Positional[Annotated[tuple[str, ...], optional("FILE [FILE ...]")]]
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
    plain_names: Flag = False
    """Name columns without spaces and signs: `NOx_simulated`, `time_s`."""
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
class Report:
    """Score a model on described records: one step, ten steps and free run.

    The first line is the verdict: good, usable with limits, or not usable, and why.

    Example:
        jaxnarx report runs/demo/model.safetensors engine.toml --out runs/check

    As a step of a pipeline:
        jaxnarx report model.safetensors engine.toml --junit verdict.xml
    """

    model: Positional[Model]
    """Model file."""
    description: Positional[Description]
    """TOML description of the records."""
    root: Folder = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    out: Folder = None
    """Folder for report.html and report.json; default: only print."""
    compare: Annotated[tuple[str, ...], optional("MODEL [MODEL ...]")] = ()
    """Other models to compare with on the same records, in free run."""
    map: Annotated[tuple[str, ...], optional("NAME NAME")] = ()
    """Two channels over which the error is mapped, lagged ones as 'speed[t-1]';
    default: the two that schedule most."""
    within: Annotated[float | None, optional("TOLERANCE")] = None
    """Tolerance of the free-run error in the unit of the outputs, such as 10: the
    report tells the share of the samples that keep it."""
    no_limits: Flag = False
    """Hold neither inputs nor outputs to their trained ranges, whatever MODEL says."""
    outside: Outside = None
    """What inputs do beyond their trained ranges: nothing, stay at the edge, or go on
    from there to first order; default: as MODEL says."""
    junit: Annotated[str | None, optional("PATH")] = None
    """File for the rules of the verdict as JUnit XML, a test case for every rule and
    output of a part; failures carry value and limit."""
    force: Flag = False
    """Overwrite an earlier report, and an earlier file of --junit."""
    require_fit: Percent = None
    """Exit with 1 unless the pooled free-run fit of every output reaches this [%]."""


@dataclasses.dataclass(frozen=True)
class Export:
    """Write a model as source files for another program, proven to do the same.

    c is C99 with one header, one source and a self-test, without heap and with `exp` of
    math.h alone, in double or single precision; fmu2 and fmu3 are units of FMI 2.0 and
    3.0 for co-simulation, binary for this machine and source for others; python and
    javascript are files of one page without dependencies; matlab is a function that
    keeps its state, for a MATLAB Function block or Octave, and a test of it; casadi is
    a module with functions of CasADi for optimal control; acados is C of the next
    state, its Jacobian and Hessian, as acados links it.

    Every one is compiled where it must be and run over the records of FILE, without any
    over steps within the trained ranges, beside the model, and over inputs that drop
    out; one that differs is not written, and the exit code is 1.

    For calibration, dcm (DCM 2.0) holds the parameters and maps of every output at rest
    over two inputs, with the others in the middle of their trained ranges, `jaxnarx
    import-dcm` takes it back; a2l (1.71) links names to the symbols of c, so that a
    tool finds their addresses.

    README.md says what was found: differences, operations,
    parameters, memory, and how to call it.

    Example:
        jaxnarx export runs/engine-good/model.safetensors engine.toml --to c python
    """

    model: Positional[Model]
    """Model file."""
    files: Positional[Annotated[tuple[str, ...], optional("[FILE ...]")]] = ()
    """Data files, or one TOML description, for the proof."""
    to: Annotated[
        tuple[
            Literal[
                "c",
                "fmu2",
                "fmu3",
                "python",
                "javascript",
                "matlab",
                "casadi",
                "acados",
                "dcm",
                "a2l",
            ],
            ...,
        ],
        arg(),
    ] = ("c",)
    """What is written."""
    map: Annotated[tuple[str, ...], optional("NAME NAME")] = ()
    """The two inputs of maps (dcm, fmu3); default: of each output the inputs that
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
    nan: Annotated[Literal["hold", "nan"] | None, optional("hold|nan")] = None
    """Outputs where an input is not finite: by its last finite value (hold), or not a
    number (nan). Such samples are flagged either way. Default: as MODEL says."""
    invalid_after: Annotated[float | None, optional("SECONDS")] = None
    """Flag outputs as invalid once an input has not been finite for so long; default:
    as MODEL says, which is its memory."""
    since: Annotated[str | None, optional("MODEL")] = None
    """Model file of the same structure, or prior of a fleet (.fleet), whose numbers the
    control unit holds already: dcm has only the tables that differ."""
    precision: Literal["double", "single", "both"] = "both"
    """Number types of C that are written and proven. With both, a model that single
    precision cannot follow is written for double alone."""
    unproven: Flag = False
    """Write without the proof."""
    force: Flag = False
    """Overwrite files of an earlier export."""


@dataclasses.dataclass(frozen=True)
class Adapt:
    """Let a model follow its engine: update its coefficients over new records.

    FILE holds columns named like the model's channels, at the model's sample time,
    measured outputs among them; or it is one TOML description. Sample by sample the
    coefficients are corrected by recursive least squares; nothing is learnt where a
    value is missing or the inputs are outside of the model's domain, and a window that
    makes the error grow is undone. FOLDER receives model.safetensors, adaptation.csv
    (by window the error, that of the model as it began, and how far it has drifted) and
    report.html; with --c also C files, with --fmu an FMU, of a model that goes on
    learning so.

    Example:
        jaxnarx adapt runs/engine/model.safetensors new_run.csv --out adapted
    """

    model: Positional[Model]
    """Model file; one without hidden states."""
    files: Positional[Annotated[tuple[str, ...], optional("FILE [FILE ...]")]]
    """Data files, or one TOML description."""
    root: Folder = None
    """Folder of the data of a description; default as for `jaxnarx report`."""
    out: Annotated[str, arg(metavar="FOLDER")] = "adapted"
    """Folder for the files."""
    forgetting: Annotated[float | None, optional("SHARE")] = None
    """Weight of a sample against the next one, up to 1 (default .998)."""
    start: Annotated[float | None, optional("VARIANCE")] = None
    """How far a coefficient may be off at the start (default .01): small trusts the
    model, large the data."""
    regressors: Literal["measured", "simulated"] = "measured"
    """Past outputs that enter: measured ones, or the model's own."""
    estimation: Literal["joint", "local"] = "joint"
    """Local models learn together, or each on its own."""
    window: Annotated[int | None, optional("SAMPLES")] = None
    """Samples after which the error is judged (default 100)."""
    largest_index: Annotated[float | None, optional("INDEX")] = None
    """Index of the model's domain up to which samples are learnt from (default 1)."""
    c: Annotated[str | None, optional("NAME")] = None
    """Write NAME.c and NAME_adapt.c: the model as it was, that learns on its unit."""
    fmu: Annotated[int | None, optional("VERSION")] = None
    """Write an FMU of this version of FMI, 2 or 3, that learns so; with the files of
    --c, named model without."""
    force: Flag = False
    """Overwrite files of an earlier run."""


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
    """Model file; it must know its domain, as what `jaxnarx identify` finds does. Or a
    fleet's prior, FILE.fleet: then the test tells most about a new engine of it."""
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
