"""A network from its exported tables, after someone has changed numbers of them."""

import dataclasses
import math

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import DataFileError, suggest
from jaxnarx.exporters._lower import lower
from jaxnarx.exporters.calibration import (
    MAP_BLOCKS,
    CalibrationBlock,
    read_arrays,
    read_dcm,
)
from jaxnarx.exporters.form import ParameterTable
from jaxnarx.exporters.maps import REST_NAME
from jaxnarx.exporters.parameters import OutputAt, network_tables
from jaxnarx.models import STORED_PROBABILITIES, Network, require_consistent, set_bounds
from jaxnarx.refinement import attach_certificate, stays_bounded


@guard_arguments
def read_parameters(network: Network, text: str, source: str = "the text") -> Network:
    """The network with the numbers of a DCM file, or of the C source, of its export.

    Blocks may be left out; maps at rest are passed over, they follow from the rest.
    Numbers are taken where they differ, in double precision, from what an export of
    `network` holds, so that everything else stays as it is to the last digit. A network
    that changes loses its prediction intervals, for they come from its own errors; a
    certificate of stability is found anew for the changed numbers or, where there is
    none, is gone with the wide bounds that it allowed. Its domain is about the training
    records and stays.

    Args:
        network: The network that was exported.
        text: Text of the file.
        source: Name of the file in errors.

    Returns:
        The network; `network` itself where no number differs.

    Raises:
        DataFileError: Unknown blocks, other sizes, texts, numbers that are not finite
            or that no such network has, with the block and its line.

    Example:
        found = jnx.export(network, to=["dcm"]).files["model.dcm"]
        changed = jnx.exporters.read_parameters(network, found.decode("latin-1"))
        print(changed is network)
    """
    known = network.errors is not None and network.domain is not None
    program = lower(
        network, level=STORED_PROBABILITIES[0] if known else None
    )  # with all its tables
    found = {t.name: t for t in program.tables if t.values.size}
    if "KONSERVIERUNG_FORMAT" in text:
        blocks = read_dcm(text, source)
    else:
        blocks = read_arrays(text, source, [f"_{name}" for name in found])
    tables, changed = network_tables(network), network
    for name, block in _match_blocks(blocks, found, source).items():
        new = _shape_numbers(block, found[name], source)
        differs = new != found[name].values
        if not np.any(differs):
            continue
        if name not in tables:
            raise _block_error(
                source,
                block,
                differs,
                "is what the model knows of its training; leave it as it is",
            )
        table, o = tables[name]
        try:
            model = table.write(OutputAt(changed, o), new, differs)
            models = (*changed.models[:o], model, *changed.models[o + 1 :])
            changed = dataclasses.replace(changed, models=models)
            require_consistent(changed)
        except ValueError as error:
            raise _block_error(
                source, block, differs, f"cannot be so: {error}"
            ) from error
    return network if changed is network else _renew_certificate(changed)


def _match_blocks(
    blocks: list[CalibrationBlock], found: dict[str, ParameterTable], source: str
) -> dict[str, CalibrationBlock]:
    """Blocks by the table they are; DataFileError where one is no table or map."""
    prefix = _prefix(blocks, found, source)
    matched = {}
    for block in blocks:
        name = block.name.removeprefix(prefix)
        if name in found and block.name != name:
            matched[name] = block
        elif block.kind not in MAP_BLOCKS or not name.startswith(f"{REST_NAME}_"):
            known = [prefix + one for one in found]
            raise DataFileError(
                f"{source}, line {block.line}: block {block.name} is no table of the "
                f"model. {suggest(block.name, known)}",
                path=source,
            )
    return matched


def _prefix(blocks, found: dict[str, ParameterTable], source: str) -> str:
    """The text before the names of all tables: the name of the export."""
    fitting: dict[str, int] = {}
    for block in blocks:
        for name in found:
            if block.name.endswith(f"_{name}"):
                lead = block.name[: -len(name)]
                fitting[lead] = fitting.get(lead, 0) + 1
    if not fitting:
        raise DataFileError(
            f"{source}: holds no table of the model, which are "
            f"{', '.join(found)} behind the name of the export",
            path=source,
        )
    return max(fitting, key=lambda lead: (fitting[lead], -len(lead)))


def _shape_numbers(
    block: CalibrationBlock, table: ParameterTable, source: str
) -> np.ndarray:
    """The numbers in the shape of the table; a C array has but their count."""
    shape = table.values.shape
    fits = (math.prod(shape),), shape[::-1], (1, *shape), (*shape, 1)
    if block.size not in fits and (block.size or table.values.size != 1):
        said = " @ ".join(map(str, block.size)) or "1"
        raise DataFileError(
            f"{source}, line {block.line}: block {block.name} is of size {said}; the "
            f"model's is {' @ '.join(map(str, shape[::-1]))}",
            path=source,
        )
    return block.values.reshape(shape)


def _block_error(
    source: str, block: CalibrationBlock, differs: np.ndarray, what: str
) -> DataFileError:
    line = block.lines[int(np.flatnonzero(differs.ravel())[0])]
    return DataFileError(
        f"{source}, line {line}: block {block.name} {what}", path=source
    )


def _renew_certificate(changed: Network) -> Network:
    """Drop what was known of the network that it was."""
    changed = dataclasses.replace(changed, errors=None)
    if changed.certificate is not None:
        proven = attach_certificate(changed)
        return proven if proven.certificate is not None else set_bounds(proven)
    kept = not changed.is_unbounded.any() or stays_bounded(changed)
    return changed if kept else set_bounds(changed)
