"""Control: a network as the model of a predictive controller.

`mpc` makes a controller of a network; its `step` says what to set at every sample, and
`close_loop` runs it against a plant: another network, a virtual engine, or a function.
`tune_effort` finds what its moves have to cost, for several plants together.
"""

from jaxnarx.control._close_loop import close_loop as close_loop
from jaxnarx.control._export_controller import export_controller as export_controller
from jaxnarx.control._mpc import mpc as mpc
from jaxnarx.control._through_casadi import CasadiController as CasadiController
from jaxnarx.control._through_casadi import CasadiState as CasadiState
from jaxnarx.control._through_casadi import through_casadi as through_casadi
from jaxnarx.control._tune_effort import tune_effort as tune_effort
from jaxnarx.control.controller import Controller as Controller
from jaxnarx.control.controller import ControlState as ControlState
from jaxnarx.control.controller import Decision as Decision
from jaxnarx.control.result import ControlledRun as ControlledRun
from jaxnarx.docstrings import document
from jaxnarx.settings import Command as Command
from jaxnarx.settings import OutputLimit as OutputLimit

__all__ = [
    "CasadiController",
    "CasadiState",
    "Command",
    "ControlState",
    "ControlledRun",
    "Controller",
    "Decision",
    "OutputLimit",
    "close_loop",
    "export_controller",
    "mpc",
    "through_casadi",
    "tune_effort",
]

document(Command, OutputLimit)
