"""What a calibration has come to."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Channel
from jaxnarx.formatting import align_columns, brief, count, page


@dataclasses.dataclass(frozen=True, eq=False)
class CalibratedMap:
    """A map before and after, in physical units; its axes are those of after.

    `visits` are the samples of the cycle that every point serves, in sums of weights;
    `gradient` has for every measure how much it changes by every point.
    """

    name: str
    over: tuple[str, ...]
    axes: tuple[Float[np.ndarray, " _"], ...]
    start_axes: tuple[Float[np.ndarray, " _"], ...]
    start: Float[np.ndarray, "*shape"]
    value: Float[np.ndarray, "*shape"]
    visits: Float[np.ndarray, "*shape"]
    gradient: Mapping[str, Float[np.ndarray, "*shape"]]
    unit: str = ""
    axis_units: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class MeasureRow:
    """A measure before and after, over all draws of the plant the mean; of a limit the
    number it must keep, how far it keeps it, and its multiplier: by how much the
    objective would fall for every share of the limit that is given away."""

    name: str
    start: float
    value: float
    limit: float | None = None
    margin: float | None = None
    multiplier: float = 0.0
    kept: bool = True
    draws_kept: float = 1.0


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Maps that were optimised over a cycle, and what the plant makes of them.

    `inputs` and `outputs` are those of the cycle by record (of the first draw of the
    plant), `start_inputs` and `start_outputs` with the maps of before; `index` is that
    of the domain, empty where the plant has none.
    """

    maps: tuple[CalibratedMap, ...]
    objective: tuple[MeasureRow, ...]
    limits: tuple[MeasureRow, ...]
    input_names: tuple[str, ...]
    output_channels: tuple[Channel, ...]
    sample_time: float
    inputs: tuple[Float[np.ndarray, "time inputs"], ...]
    outputs: tuple[Float[np.ndarray, "time outputs"], ...]
    start_inputs: tuple[Float[np.ndarray, "time inputs"], ...]
    start_outputs: tuple[Float[np.ndarray, "time outputs"], ...]
    index: tuple[Float[np.ndarray, " time"], ...] = ()
    start_index: tuple[Float[np.ndarray, " time"], ...] = ()

    def __getitem__(self, name: str) -> CalibratedMap:
        """A map by its name."""
        return next(m for m in self.maps if m.name == name)

    @property
    def kept(self) -> bool:
        """Whether all limits hold."""
        return all(row.kept for row in self.limits)

    def __str__(self) -> str:
        """Measures and limits before and after, and how far maps have moved."""
        rows = [("", "before", "after", "limit", "margin")]
        rows += [
            (r.name, f"{r.start:.5g}", f"{r.value:.5g}", "", "") for r in self.objective
        ]
        rows += [
            (
                r.name,
                f"{r.start:.5g}",
                f"{r.value:.5g}",
                f"{r.limit:.5g}",
                f"{r.margin:.3g}" if r.kept else f"{r.margin:.3g}, broken",
            )
            for r in self.limits
        ]
        moved = [
            f"{m.name}: {count(m.value.size, 'point')}, moved by "
            f"{np.abs(m.value - m.start).max():.3g} at most; "
            f"{count(int((m.visits < 1e-9).sum()), 'point')} never visited"
            for m in self.maps
        ]
        return "\n".join(["Calibration", *align_columns(rows), *moved])

    def to_dict(self) -> dict[str, Any]:
        """Maps and rows as JSON has them."""
        return {
            "maps": {
                m.name: {
                    "over": list(m.over),
                    "axes": [a.tolist() for a in m.axes],
                    "start": m.start.tolist(),
                    "value": m.value.tolist(),
                    "visits": m.visits.tolist(),
                    "unit": m.unit,
                }
                for m in self.maps
            },
            "objective": [dataclasses.asdict(r) for r in self.objective],
            "limits": [dataclasses.asdict(r) for r in self.limits],
        }

    __repr__, _repr_html_ = brief, page
