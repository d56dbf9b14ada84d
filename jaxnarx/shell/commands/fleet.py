"""The commands about fleets: learn, calibrate an engine, compare, report. No jax."""

import dataclasses
from typing import Annotated

from tyro.conf import Positional, arg

from jaxnarx.shell.commands.annotations import Flag, Folder, optional

Prior = Annotated[str, arg(metavar="PRIOR")]


@dataclasses.dataclass(frozen=True)
class FleetLearn:
    """Learn what the engines of a fleet have in common, from donors.

    The description (TOML) names the donors as that of a sweep does: descriptions of
    measured engines, or relatives of a virtual one. Their structure is that of --model,
    or of the section [identification], or what a search finds on up to 64 of them,
    judged on engines that were left out. Donors unlike all others are named and not
    used. FOLDER receives prior.fleet and report.html, and keeps what is needed to go on
    where the command was stopped: give it again.

    Example:
        jaxnarx fleet learn donors.toml --out runs/line

    A small description, donors.toml:
        [data]
        engines = ["engines/*.toml"]
    """

    description: Positional[Annotated[str, arg(metavar="DESCRIPTION")]]
    """TOML description of the donors."""
    model: Annotated[str | None, optional("MODEL")] = None
    """Model file whose structure all engines share."""
    preset: str = "quick"
    """Preset of the search, where one is needed; see `jaxnarx identify --help`."""
    gates: Flag = False
    """Engines differ in the gates of their regions too."""
    out: Folder = None
    """Folder for the prior; default: runs/ and the description's name."""
    force: Flag = False
    """Overwrite an earlier prior."""


@dataclasses.dataclass(frozen=True)
class FleetCalibrate:
    """Calibrate the model of a new engine from few samples, by what a fleet has taught.

    FILE holds columns named like the fleet's channels, at its sample time, or is one
    TOML description. The mean of the fleet as it is, an offset and a gain, the mean
    with the fleet's spread, and the new samples alone compete. FOLDER receives
    model.safetensors, for every command that takes a model, and calibration.json.

    Example:
        jaxnarx fleet calibrate runs/line/prior.fleet new.csv --out runs/new
    """

    prior: Positional[Prior]
    """Prior file of `jaxnarx fleet learn`."""
    files: Positional[Annotated[tuple[str, ...], optional("FILE [FILE ...]")]]
    """Data files of the engine, or one TOML description."""
    root: Folder = None
    """Folder of the data of a description; default as for `jaxnarx report`."""
    out: Annotated[str, arg(metavar="FOLDER")] = "calibrated"
    """Folder for the model."""
    force: Flag = False
    """Overwrite files of an earlier run."""


@dataclasses.dataclass(frozen=True)
class FleetCompare:
    """Tell whether an engine is still itself, from files of before and of later.

    Both hold columns named like the fleet's channels. The exit code is 1 where it is
    another engine, or has changed.

    Example:
        jaxnarx fleet compare runs/line/prior.fleet march.csv october.csv
    """

    prior: Positional[Prior]
    """Prior file of `jaxnarx fleet learn`."""
    earlier: Positional[Annotated[str, arg(metavar="EARLIER")]]
    """Data file, or TOML description, of the earlier records."""
    later: Positional[Annotated[str, arg(metavar="LATER")]]
    """Data file, or TOML description, of the later ones."""
    root: Folder = None
    """Folder of the data of descriptions; default as for `jaxnarx report`."""


@dataclasses.dataclass(frozen=True)
class FleetReport:
    """Tell what a prior holds: spread, donors, and what how many samples reach.

    Example:
        jaxnarx fleet report runs/line/prior.fleet --out runs/line-report
    """

    prior: Positional[Prior]
    """Prior file of `jaxnarx fleet learn`."""
    out: Folder = None
    """Folder for report.html; default: only print."""
    force: Flag = False
    """Overwrite an earlier report."""
