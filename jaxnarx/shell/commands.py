"""The commands and their flags. No jax here: `--help` answers at once.

Each command is a frozen dataclass; its docstring and those of its fields are the help.
The work is done by `jaxnarx.shell.work`, imported when a command runs.
"""

import dataclasses
from typing import Annotated, Literal

import tyro

Positional = tyro.conf.Positional


@dataclasses.dataclass(frozen=True)
class Demo:
    """Identify a virtual engine, from duty cycle to speed, and write the report.

    Simulates the port-injected engine test bed, chooses terms, divides the operating
    space into up to four local models, refines them together with the partition on
    simulation error, and reports on a record that took no part. Needs no files.

    Example:
        jaxnarx demo --out runs/first
    """

    out: str | None = None
    """Folder for model and report; default: a new one under runs/."""
    models: int = 4
    """Largest number of local models."""
    events: int = 2000
    """Length of each of the three records, in events of 180 degrees."""
    seed: int = 1
    """Seed of the excitation signals and the measurement noise."""
    force: bool = False
    """Write into a folder that already holds a model."""


@dataclasses.dataclass(frozen=True)
class Identify:
    """Identify a model from measured records and write model and report.

    The description (TOML) names files, channels, units and which records train, validate
    and test. Without validation records some are held out of training. Terms are chosen
    by forward OLS-ERR, regions by LOLIMOT, and all parameters are refined together on the
    free-run error.

    Example:
        jaxnarx identify engine.toml --output NOx --models 6 --degree 1 --terms 12
          --schedule "speed[t]" "load[t]"
    """

    description: Positional[str]
    """TOML description of the records."""
    output: tuple[str, ...] = ()
    """Outputs to model; default: all of the description."""
    input_lags: tuple[int, ...] = (0, 1, 2, 4, 8, 16)
    """Input lags in samples; `jaxnarx check` suggests some."""
    output_lags: tuple[int, ...] = (1, 2)
    """Output lags in samples, fed back in a free run."""
    degree: int = 2
    """Largest number of factors of a term."""
    terms: int = 25
    """Number of terms of every local model."""
    constant: Literal["first", "candidate", "after"] = "first"
    """Constant term: chosen first, a candidate, or added after the choice (thesis)."""
    models: int = 1
    """Largest number of local models."""
    schedule: tuple[str, ...] = ()
    """Scheduling variables of the regions, such as "speed[t]"; needed for --models > 1."""
    k_sigma: float = 1 / 3
    """Width of a region's Gaussian as a share of its box."""
    horizons: tuple[int, ...] = (10, 30, 100, 300, 1000)
    """Window lengths of the refinement before the full record, in samples."""
    steps: int = 40
    """Refinement steps on full records; 0 keeps the one-step model."""
    window_steps: int = 20
    """Refinement steps at each window length."""
    ridge: float = 1e-5
    """Pull of the parameters towards the one-step model."""
    hold_out: float = 0.2
    """Share of the training samples that validates, where no record is named for it."""
    root: str | None = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    out: str | None = None
    """Folder for model and report; default: a new one under runs/."""
    force: bool = False
    """Write into a folder that already holds a model."""
    require_fit: float | None = None
    """Exit with 1 unless the pooled free-run fit of every output reaches this [%]."""


@dataclasses.dataclass(frozen=True)
class Simulate:
    """Run a model freely on new files and write its outputs as CSV.

    FILES are CSV or Parquet with columns named like the model's channels, or one TOML
    description. Measured outputs are needed for the first samples, and are compared
    with where they are present.

    Example:
        jaxnarx simulate runs/demo/model.safetensors new_run.csv --out simulated
    """

    model: Positional[str]
    """Model file."""
    files: Positional[tuple[str, ...]]
    """Data files, or one TOML description."""
    steps: int | None = None
    """Predict this many steps ahead instead of running freely."""
    root: str | None = None
    """Folder of the data of a description."""
    out: str = "simulated"
    """Folder for the CSV files."""
    force: bool = False
    """Overwrite files of an earlier run."""


@dataclasses.dataclass(frozen=True)
class Report:
    """Score a model on described records: one step, ten steps and free run.

    Example:
        jaxnarx report runs/demo/model.safetensors engine.toml --out runs/check
    """

    model: Positional[str]
    """Model file."""
    description: Positional[str]
    """TOML description of the records."""
    root: str | None = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    out: str | None = None
    """Folder for report.html and report.json; default: only print."""
    force: bool = False
    """Overwrite an earlier report."""
    require_fit: float | None = None
    """Exit with 1 unless the pooled free-run fit of every output reaches this [%]."""


@dataclasses.dataclass(frozen=True)
class Check:
    """Look at data before anything is fitted: what may spoil a model, and which lags.

    Reports constants, duplicates, gaps, saturation, spikes, excitation, dead time and
    feedback, and suggests lags.

    Example:
        jaxnarx check engine.toml
    """

    description: Positional[str]
    """TOML description of the records."""
    root: str | None = None
    """Folder of the data; default JAXNARX_DATA, else the description's folder."""
    json: bool = False
    """Print the findings as JSON."""


Command = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Identify, tyro.conf.subcommand("identify")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Check, tyro.conf.subcommand("check")]
)
