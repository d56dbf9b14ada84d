"""Descriptions of an FMU: modelDescription.xml and buildDescription.xml."""

import importlib.metadata
from collections.abc import Sequence
from xml.etree import ElementTree as ET

from jaxnarx.data import base_unit
from jaxnarx.exporters.code import digits
from jaxnarx.exporters.fmu.markup import xml_text
from jaxnarx.exporters.fmu.variables import Quantity, units
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.interpret import STARTS

NUMBER_TYPES = {"real": "Float64", "boolean": "Boolean", "choice": "Enumeration"}
"""Types of FMI 3.0."""


def fmi2(
    program: SampleProgram,
    variables: Sequence[Quantity],
    token: str,
    sources: Sequence[str],
    *,
    slopes: bool = True,
) -> str:
    """modelDescription.xml of FMI 2.0; places there count from one. `slopes`: with
    derivatives."""
    root = _root(program, "2.0", guid=token)
    unit = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=program.name,
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative=str(slopes).lower(),
    )
    files = ET.SubElement(unit, "SourceFiles")
    for name in sources:
        ET.SubElement(files, "File", name=name)
    _units(root, variables)
    own = ET.SubElement(ET.SubElement(root, "TypeDefinitions"), "SimpleType")
    own.set("name", "Start")
    _items(ET.SubElement(own, "Enumeration"))
    _experiment(root, program)
    listed = ET.SubElement(root, "ModelVariables")
    types = {"real": "Real", "boolean": "Boolean", "choice": "Enumeration"}
    for n, v in enumerate(variables):
        scalar = ET.SubElement(
            listed, "ScalarVariable", name=v.name, valueReference=str(n)
        )
        _common(scalar, v)
        _set_type(ET.SubElement(scalar, types[v.kind]), v)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = ET.SubElement(structure, "Outputs")
    first = ET.SubElement(structure, "InitialUnknowns")
    for n, v in enumerate(variables):
        if v.causality == "output":
            sees = " ".join(str(k + 1) for k in v.sees)
            ET.SubElement(outputs, "Unknown", index=str(n + 1), dependencies=sees)
            ET.SubElement(first, "Unknown", index=str(n + 1))
    return xml_text(root)


def fmi3(
    program: SampleProgram,
    variables: Sequence[Quantity],
    token: str,
    *,
    slopes: bool = True,
) -> str:
    """modelDescription.xml of FMI 3.0; `slopes`: with derivatives."""
    root = _root(program, "3.0", instantiationToken=token)
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=program.name,
        canHandleVariableCommunicationStepSize="false",
        fixedInternalStepSize=digits(program.sample_time),
        hasEventMode="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesDirectionalDerivatives=str(slopes).lower(),
        providesAdjointDerivatives=str(slopes).lower(),
    )
    _units(root, variables)
    own = ET.SubElement(ET.SubElement(root, "TypeDefinitions"), "EnumerationType")
    own.set("name", "Start")
    _items(own)
    _experiment(root, program)
    listed = ET.SubElement(root, "ModelVariables")
    for n, v in enumerate(variables):
        kind = NUMBER_TYPES.get(v.kind, "Float64")
        one = ET.SubElement(listed, kind, name=v.name, valueReference=str(n))
        _common(one, v)
        _set_type(one, v)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [(n, v) for n, v in enumerate(variables) if v.causality == "output"]
    for n, v in outputs:
        ET.SubElement(
            structure,
            "Output",
            valueReference=str(n),
            dependencies=" ".join(map(str, v.sees)),
        )
    for n, _ in outputs:
        ET.SubElement(structure, "InitialUnknown", valueReference=str(n))
    return xml_text(root)


def build(program: SampleProgram, sources: Sequence[str]) -> str:
    """sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    one = ET.SubElement(root, "BuildConfiguration", modelIdentifier=program.name)
    files = ET.SubElement(one, "SourceFileSet", language="C99")
    for name in sources:
        ET.SubElement(files, "SourceFile", name=name)
    return xml_text(root)


def _root(program: SampleProgram, version: str, **named: str) -> ET.Element:
    outputs = ", ".join(p.name for p in program.reported)
    inputs = ", ".join(p.name for p in program.inputs)
    attributes = {
        "fmiVersion": version,
        "modelName": program.name,
        **named,
        "description": f"{outputs} from {inputs}",
        "generationTool": f"jaxnarx {importlib.metadata.version('jaxnarx')}",
        "variableNamingConvention": "flat",
    }
    return ET.Element("fmiModelDescription", attributes)


def _units(root: ET.Element, variables: Sequence[Quantity]) -> None:
    found = units(variables)
    if found:
        place = ET.SubElement(root, "UnitDefinitions")
        for unit in found:
            _set_base(ET.SubElement(place, "Unit", name=unit), unit)


def _set_base(place: ET.Element, unit: str) -> None:
    """Say what a unit is in those of SI, if it is known."""
    base = base_unit(unit)
    if base is not None:
        numbers = {"factor": base.factor, "offset": base.offset}
        told = {k: str(v) for k, v in base.exponents.items()}
        told |= {k: digits(v) for k, v in numbers.items()}
        ET.SubElement(place, "BaseUnit", told)


def _items(place: ET.Element) -> None:
    for n, (name, about) in enumerate(STARTS.items()):
        ET.SubElement(place, "Item", name=name, value=str(n), description=about)


def _experiment(root: ET.Element, program: SampleProgram) -> None:
    log = ET.SubElement(root, "LogCategories")
    for name in ("logStatusError", "logStatusWarning"):
        ET.SubElement(log, "Category", name=name)
    step = program.sample_time
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=digits(100 * step),
        stepSize=digits(step),
    )


def _common(element: ET.Element, v: Quantity) -> None:
    element.set("description", v.about)
    element.set("causality", v.causality)
    if v.kind == "time":
        element.set("variability", "continuous")
        return
    if v.shape:
        element.set("variability", "constant")
        return
    parameter = v.causality == "parameter"
    element.set("variability", "fixed" if parameter else "discrete")
    if v.causality != "input":
        element.set("initial", "exact" if parameter else "calculated")


def _set_type(element: ET.Element, v: Quantity) -> None:
    if v.kind == "choice":
        element.set("declaredType", "Start")
    if v.unit:
        element.set("unit", v.unit)
    if v.relative:
        element.set("relativeQuantity", "true")
    if v.shape:
        element.set("start", " ".join(map(digits, v.values)))
        for size in v.shape:
            ET.SubElement(element, "Dimension", start=str(size))
    if v.start is not None:
        whole = v.kind == "choice"
        element.set("start", str(int(v.start)) if whole else digits(v.start))
