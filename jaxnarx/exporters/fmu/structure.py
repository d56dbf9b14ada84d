"""FMI-LS-STRUCT 1.0.0-rc.1: maps of outputs at rest, known as maps by importers.

The values of a map and the points of its axes are constants of the FMU, arrays of FMI
3.0, and a terminal groups them, so that an importer shows them as a map. Modelica
Association Project FMI, FMI Layered Standard for Structured Data: the manifest, and
maps that are sampled on rectilinear grids.
"""

import dataclasses
from collections.abc import Sequence
from xml.etree import ElementTree as ET

import numpy as np

from jaxnarx.exporters.fmu.markup import layered_manifest, xml_text
from jaxnarx.exporters.fmu.variables import Quantity, free_name
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.maps import REST_NAME, RestMap

NAME, VERSION = "org.fmi-standard.fmi-ls-struct", "1.0.0-rc.1"
ABOUT = "Layered standard for structuring of variables"
"""The description that the standard demands."""
MANIFEST_PLACE = f"extra/{NAME}/fmi-ls-manifest.xml"
TERMINALS_PLACE = "terminalsAndIcons/terminalsAndIcons.xml"


@dataclasses.dataclass(frozen=True)
class StructuredMap:
    """The variables of a map: the inputs it goes over, points of its axes, values."""

    inputs: tuple[Quantity, ...]
    axes: tuple[Quantity, ...]
    values: Quantity


def structure_maps(
    maps: Sequence[RestMap], program: SampleProgram, variables: Sequence[Quantity]
) -> tuple[StructuredMap, ...]:
    """The variables of every map, with names that `variables` do not have. Maps that
    have points without a state of rest are left out."""
    taken = {v.name for v in variables}
    found = []
    for one in maps:
        if not np.all(np.isfinite(one.values)):
            continue
        of = f"{REST_NAME}.{one.output.name}"
        over = " and ".join(port.name for port in one.axes)
        about = (
            f"{one.output.name} at rest over {over}, other inputs in the middle of "
            "their trained ranges"
        )
        values = _array(free_name(of, taken), about, one.output.unit, one.values)
        axes = [
            _array(free_name(f"{of}.{p.name}", taken), f"points of {p.name}", p.unit, x)
            for p, x in zip(one.axes, one.points, strict=True)
        ]
        inputs = [variables[program.inputs.index(port)] for port in one.axes]
        found.append(StructuredMap(tuple(inputs), tuple(axes), values))
    return tuple(found)


def _array(name: str, about: str, unit: str, values: np.ndarray) -> Quantity:
    numbers = tuple(float(x) for x in values.ravel())
    return Quantity(
        name, "array", "local", about, unit, values=numbers, shape=values.shape
    )


def structure_files(maps: Sequence[StructuredMap]) -> dict[str, str]:
    """Manifest and terminals by their place in the archive; nothing without maps."""
    if not maps:
        return {}
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = ET.SubElement(root, "Terminals")
    for one in maps:
        place = ET.SubElement(
            listed,
            "Terminal",
            name=one.values.name,
            terminalKind=f"{NAME}.map.rectilinearGrid",
            matchingRule=f"{NAME}.map",
            description=one.values.about,
        )
        for now, axis in zip(one.inputs, one.axes, strict=True):
            _add_member(place, axis.name, "domain")
            _add_member(place, now.name, "domainInput")
        _add_member(place, one.values.name, "codomain")
    manifest = layered_manifest(NAME, VERSION, ABOUT)
    return {TERMINALS_PLACE: xml_text(root), MANIFEST_PLACE: xml_text(manifest)}


def _add_member(place: ET.Element, name: str, kind: str) -> None:
    ET.SubElement(
        place,
        "TerminalMemberVariable",
        variableName=name,
        memberName=name,
        variableKind=f"{NAME}.map.{kind}",
    )
