"""The commands and their flags. No jax here: `--help` answers at once.

Each command is a frozen dataclass; its docstring and those of its fields are the help.
The work is done by `jaxnarx.shell.dispatch`, imported when a command runs.
"""

import inspect
import re
from typing import get_args

from jaxnarx.settings import DESCRIPTION
from jaxnarx.shell.commands.calibrate import Calibrate as Calibrate
from jaxnarx.shell.commands.control import Control as Control
from jaxnarx.shell.commands.fleet import FleetCalibrate as FleetCalibrate
from jaxnarx.shell.commands.fleet import FleetCompare as FleetCompare
from jaxnarx.shell.commands.fleet import FleetLearn as FleetLearn
from jaxnarx.shell.commands.fleet import FleetReport as FleetReport
from jaxnarx.shell.commands.identify import Demo as Demo
from jaxnarx.shell.commands.identify import Identify as Identify
from jaxnarx.shell.commands.identify import Invert as Invert
from jaxnarx.shell.commands.records import Check as Check
from jaxnarx.shell.commands.records import Describe as Describe
from jaxnarx.shell.commands.records import Prepare as Prepare
from jaxnarx.shell.commands.records import SimulateEngine as SimulateEngine
from jaxnarx.shell.commands.search import Automatic as Automatic
from jaxnarx.shell.commands.search import Choose as Choose
from jaxnarx.shell.commands.search import Leaderboard as Leaderboard
from jaxnarx.shell.commands.sweep import Sweep as Sweep
from jaxnarx.shell.commands.use import Adapt as Adapt
from jaxnarx.shell.commands.use import Export as Export
from jaxnarx.shell.commands.use import ImportDcm as ImportDcm
from jaxnarx.shell.commands.use import Plan as Plan
from jaxnarx.shell.commands.use import Report as Report
from jaxnarx.shell.commands.use import Simulate as Simulate


def _kebab(name: str) -> str:
    """A class name as it is typed: `SimulateEngine` is `simulate-engine`, and
    `FleetLearn` is `fleet learn`."""
    typed = re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower()
    return typed.replace("fleet-", "fleet ")


FleetCommand = FleetLearn | FleetCalibrate | FleetCompare | FleetReport
Command = (
    Describe
    | Check
    | Prepare
    | SimulateEngine
    | Demo
    | Identify
    | Leaderboard
    | Choose
    | Invert
    | Report
    | Plan
    | Simulate
    | Adapt
    | Calibrate
    | Control
    | Export
    | ImportDcm
    | Sweep
    | FleetCommand
)
_DESCRIPTION_COMMANDS = (Identify, Invert, Report, Prepare)
_DESCRIPTION_POINTER = "All keys of a description of records: `jaxnarx check --help`."


def help_of(command: type) -> str:
    """The help of a command; `check` has the description that others read."""
    text = inspect.getdoc(command) or ""
    if command is Check:
        return f"{text}\n\n{DESCRIPTION}"
    return (
        f"{text}\n\n{_DESCRIPTION_POINTER}"
        if command in _DESCRIPTION_COMMANDS
        else text
    )


COMMANDS: dict[str, type] = {_kebab(c.__name__): c for c in get_args(Command)}
"""By task, as `jaxnarx --help` lists them."""
