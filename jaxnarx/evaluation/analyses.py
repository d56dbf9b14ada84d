"""The analyses of a report that make sections: the package's own, and others'."""

from collections.abc import Callable

from jaxnarx.evaluation._input_densities import input_densities
from jaxnarx.evaluation.section import FreeRun, Section
from jaxnarx.extensions import Registry, load_packages

Analysis = Callable[[FreeRun], Section | None]
ANALYSES: Registry[Analysis] = Registry(
    "analysis of reports", {"inputs": input_densities}
)
"""By their key in `report.json`, under `sections`; other packages may add some."""


def run_analyses(run: FreeRun) -> dict[str, Section]:
    """The sections of all analyses by name; one that fails says so, and the report goes
    on."""
    found: dict[str, Section] = {}
    load_packages()
    for name, analysis in ANALYSES.items():
        try:
            section = analysis(run)
        except Exception as error:
            why = f"{type(error).__name__}: {error}"
            section = Section(name, (f"The analysis {name!r} failed: {why}",))
        if section is not None:
            found[name] = section
    return found
