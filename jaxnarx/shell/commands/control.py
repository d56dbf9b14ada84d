"""The command that makes a predictive controller of a model. No jax."""

import dataclasses
from typing import Annotated

from tyro.conf import Positional, arg

from jaxnarx.shell.commands.annotations import Flag, Folder, Model, optional


@dataclasses.dataclass(frozen=True)
class Control:
    """Make a predictive controller of a model, try it, and write its C.

    FILE are measured records that took no part in the training, with columns named like
    the model's channels, at its sample time; or one TOML description. Their outputs are
    the references that are followed, and what the model errs by over them is what the
    controller's observer expects. FOLDER receives NAME_control.h and NAME_control.c,
    proven beside the controller, control.json, loop.csv and tracking.png.

    Example:
        jaxnarx control runs/engine/model.safetensors new.csv --task idle.toml

    A small file, idle.toml:
        targets = ["speed"]
        horizon = 20
        [commands.duty]
        rate = 0.5           # a second; also low, high and effort
        [limits.MAP]
        at_most = 60.0
        [noise]              # of the sensors in the loop
        speed = 2.0
    """

    model: Positional[Model]
    """Model file; it must compute all outputs that it looks at."""
    files: Positional[Annotated[tuple[str, ...], optional("FILE [FILE ...]")]]
    """Data files, or one TOML description."""
    task: Annotated[str, arg(metavar="TASK")]
    """TOML file of commands, targets and limits."""
    plant: Annotated[tuple[str, ...], optional("MODEL")] = ()
    """Model files that play the engine, the first of them in what is written; default:
    MODEL itself, which shows what the controller wants and not what an engine does."""
    tune: Flag = False
    """Tune what moves cost so that limits are kept, and errors are small, with every
    one of --plant."""
    name: str = "model"
    """Name of the files of C and of their functions."""
    root: Folder = None
    """Folder of the data of a description; default as for `jaxnarx report`."""
    out: Annotated[str, arg(metavar="FOLDER")] = "control"
    """Folder for the files."""
    force: Flag = False
    """Overwrite files of an earlier run."""
