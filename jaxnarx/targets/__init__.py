"""Models for other programs: C, Python, JavaScript, with the proof that they equal."""

from jaxnarx.targets.export import TARGETS as TARGETS
from jaxnarx.targets.export import Exported as Exported
from jaxnarx.targets.export import export as export
from jaxnarx.targets.export import write_files as write_files
from jaxnarx.targets.form import SampleProgram as SampleProgram
from jaxnarx.targets.interpret import Instance as Instance
from jaxnarx.targets.lower import lower as lower
from jaxnarx.targets.proof import ExportError as ExportError
from jaxnarx.targets.scripts import javascript as javascript
