"""The command that optimises maps of a control unit. No jax."""

import dataclasses
from typing import Annotated

from tyro.conf import Positional, arg

from jaxnarx.shell.commands.annotations import Flag, Folder, Model


@dataclasses.dataclass(frozen=True)
class Calibrate:
    """Optimise maps that set a model's inputs, over a cycle, within limits.

    CYCLE is a data file with a column for every input that no map sets, and for signals
    to be followed, at the model's sample time; or a TOML description. MAPS says what
    may be moved, what is to be small, and what must be kept. FOLDER receives maps.dcm,
    calibration.json, cycle.csv and report.html; a command that was stopped goes on
    there.

    Example:
        jaxnarx calibrate runs/engine/model.safetensors cycle.csv --maps maps.toml

    A small file, maps.toml:
        [maps.cam]
        over = ["speed", "throttle"]
        size = [6, 6]        # or dcm = "base.dcm" and block = "KF_CAM", to begin there
        [[objective]]
        of = "NOx"
        [[limits]]
        of = "torque"
        at_least = 0.99
        of_start = true
    """

    model: Positional[Model]
    """Model file; it must compute all outputs that it looks at."""
    cycle: Positional[Annotated[str, arg(metavar="CYCLE")]]
    """Data file, or TOML description, of the cycle."""
    maps: Annotated[str, arg(metavar="MAPS")]
    """TOML file of maps, objective and limits."""
    root: Folder = None
    """Folder of the data of a description; default as for `jaxnarx report`."""
    out: Annotated[str, arg(metavar="FOLDER")] = "calibration"
    """Folder for the files."""
    force: Flag = False
    """Overwrite files of an earlier calibration."""
