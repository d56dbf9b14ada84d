"""Models for other programs, from C to calibration files, proven to do the same."""

from jaxnarx.exporters._export import TARGETS as TARGETS
from jaxnarx.exporters._export import Exported as Exported
from jaxnarx.exporters._export import export as export
from jaxnarx.exporters._export import make_golden as make_golden
from jaxnarx.exporters._export import write_files as write_files
from jaxnarx.exporters._javascript import javascript as javascript
from jaxnarx.exporters._lower import lower as lower
from jaxnarx.exporters.c_adapt import AdaptiveProgram as AdaptiveProgram
from jaxnarx.exporters.c_adapt import adaptive_files as adaptive_files
from jaxnarx.exporters.c_control import ControlProgram as ControlProgram
from jaxnarx.exporters.c_control import FeedbackLine as FeedbackLine
from jaxnarx.exporters.c_control import control_files as control_files
from jaxnarx.exporters.calibration import map_of as map_of
from jaxnarx.exporters.calibration import read_dcm as read_dcm
from jaxnarx.exporters.calibration import read_text as read_text
from jaxnarx.exporters.compilers import compiler as compiler
from jaxnarx.exporters.dcm import map_lines as map_lines
from jaxnarx.exporters.dcm import sanitise as sanitise
from jaxnarx.exporters.fmu import FMI_VERSIONS as FMI_VERSIONS
from jaxnarx.exporters.fmu import fmu_runner as fmu_runner
from jaxnarx.exporters.fmu import learning_fmu as learning_fmu
from jaxnarx.exporters.form import BLEND as BLEND
from jaxnarx.exporters.form import BOTH as BOTH
from jaxnarx.exporters.form import FILTERS as FILTERS
from jaxnarx.exporters.form import FRAME as FRAME
from jaxnarx.exporters.form import ONLY_DOUBLE as ONLY_DOUBLE
from jaxnarx.exporters.form import ONLY_SINGLE as ONLY_SINGLE
from jaxnarx.exporters.form import TERMS as TERMS
from jaxnarx.exporters.form import WEIGHTS as WEIGHTS
from jaxnarx.exporters.form import SampleProgram as SampleProgram
from jaxnarx.exporters.interpret import Instance as Instance
from jaxnarx.exporters.names import identifiers as identifiers
from jaxnarx.exporters.parameters import (
    count_stored_for_weights as count_stored_for_weights,
)
from jaxnarx.exporters.proof import DOUBLE_TOLERANCE as DOUBLE_TOLERANCE
from jaxnarx.exporters.proof import Case as Case
from jaxnarx.exporters.proof import ExportError as ExportError
from jaxnarx.exporters.proof import Runner as Runner
from jaxnarx.exporters.proof import make_cases as make_cases
from jaxnarx.exporters.proof import worst as worst
from jaxnarx.exporters.readback import read_parameters as read_parameters
from jaxnarx.exporters.runners import AdaptationRunner as AdaptationRunner
from jaxnarx.exporters.runners import ControllerRun as ControllerRun
from jaxnarx.exporters.runners import adaptation_runner as adaptation_runner
from jaxnarx.exporters.runners import controller_runner as controller_runner
from jaxnarx.exporters.runners import import_page as import_page
from jaxnarx.exporters.target import Target as Target

__all__ = [
    "BOTH",
    "Case",
    "DOUBLE_TOLERANCE",
    "ExportError",
    "Exported",
    "Instance",
    "ONLY_DOUBLE",
    "ONLY_SINGLE",
    "SampleProgram",
    "TARGETS",
    "Target",
    "export",
    "javascript",
    "lower",
    "read_parameters",
    "worst",
    "write_files",
]
"""Names for users; other rooms may import every name above."""
