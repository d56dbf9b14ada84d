"""The verb `read_map`: a map of a DCM file as what a calibration begins with."""

import dataclasses
import os

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import DataFileError, SpecError, suggest
from jaxnarx.exporters import map_of, read_dcm, read_text
from jaxnarx.settings import Calibratable


@guard_arguments
def read_map(
    path: str | os.PathLike[str], block: str, given: Calibratable
) -> Calibratable:
    """A scalar, curve or map of a DCM file (2.0) as the start of a calibration.

    Args:
        path: The file; ISO 8859-1.
        block: Name of the block: FESTWERT, or one of the kinds of KENNLINIE and
            KENNFELD.
        given: What it goes over, one signal for each axis of the block, the first for
            X; its bounds, and what else a calibratable has. Its axes, size and start
            are taken from the file.

    Returns:
        The calibratable with the block's axes and values.

    Raises:
        DataFileError: no such file or block, or none of numbers over rising points.
        SpecError: another number of signals than the block has axes.

    Example:
        cam = jnx.calibration.Calibratable(("speed", "throttle"), low=0.0, high=30.0)
        try:
            cam = jnx.calibration.read_map("base.dcm", "KF_CAM", cam)
        except jnx.errors.DataFileError as error:
            print(error)
    """
    source = str(path)
    blocks = {one.name: one for one in read_dcm(read_text(path), source)}
    if block not in blocks:
        raise DataFileError(
            f"{source} has no block {block}. {suggest(block, list(blocks))}",
            path=source,
        )
    axes, value = map_of(blocks[block], source)
    if len(given.over) != len(axes):
        raise SpecError(
            f"block {block} has {len(axes)} axes; it goes over as many signals, not "
            f"over {len(given.over)}",
            field="over",
        )
    points = tuple(tuple(a.tolist()) for a in axes)
    return dataclasses.replace(given, axes=points, size=(), start=value.tolist())
