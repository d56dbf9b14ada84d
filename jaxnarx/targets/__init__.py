"""Models for other programs, from C to calibration files, proven to do the same."""

from jaxnarx.targets._export import TARGETS as TARGETS
from jaxnarx.targets._export import Exported as Exported
from jaxnarx.targets._export import export as export
from jaxnarx.targets._export import golden_of as golden_of
from jaxnarx.targets._export import write_files as write_files
from jaxnarx.targets._javascript import javascript as javascript
from jaxnarx.targets._lower import lower as lower
from jaxnarx.targets.form import BOTH as BOTH
from jaxnarx.targets.form import ONLY_DOUBLE as ONLY_DOUBLE
from jaxnarx.targets.form import ONLY_SINGLE as ONLY_SINGLE
from jaxnarx.targets.form import SampleProgram as SampleProgram
from jaxnarx.targets.interpret import Instance as Instance
from jaxnarx.targets.proof import DOUBLE as DOUBLE
from jaxnarx.targets.proof import Case as Case
from jaxnarx.targets.proof import ExportError as ExportError
from jaxnarx.targets.proof import cases_of as cases_of
from jaxnarx.targets.proof import worst as worst
from jaxnarx.targets.readback import read_parameters as read_parameters
from jaxnarx.targets.target import Target as Target

__all__ = [
    "BOTH",
    "Case",
    "DOUBLE",
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
