"""A model as an FMU of FMI 2.0 or 3.0 for co-simulation: sources and a binary."""

from jaxnarx.exporters.fmu.pack import fmu as fmu
from jaxnarx.exporters.fmu.pack import learning_fmu as learning_fmu
from jaxnarx.exporters.fmu.prove import fmu_runner as fmu_runner
from jaxnarx.exporters.fmu.prove import prove_fmu2 as prove_fmu2
from jaxnarx.exporters.fmu.prove import prove_fmu3 as prove_fmu3

FMI_VERSIONS = {"fmu2": 2, "fmu3": 3}
"""Versions of FMI by target."""
