"""A free run and where it is enclosed: what intervals and bands have in common."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.formatting import align_columns, brief, page, some
from jaxnarx.simulation import Trajectories


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class AbstractEnclosure:
    """A free run with a lower and an upper end of probability `level`, one array per
    record, in physical units."""

    run: Trajectories
    lower: tuple[Float[np.ndarray, "_ outputs"], ...]
    upper: tuple[Float[np.ndarray, "_ outputs"], ...]
    level: float

    def __str__(self) -> str:
        """Mean width by record and output."""
        name = type(self).__name__
        records = f"{100 * self.level:g} % {name.lower()} of {len(self)} records"
        rows = [("record", *self.run.output_names)]
        for record, low, high in zip(
            self.run.names, self.lower, self.upper, strict=True
        ):
            width = np.mean(high - low, axis=0).tolist()
            rows.append((record, *(f"{value:.4g}" for value in width)))
        return "\n".join([f"{name}: {records}, mean width", *some(align_columns(rows))])

    __repr__, _repr_html_ = brief, page

    def __len__(self) -> int:
        return len(self.lower)

    @property
    def scored(self) -> tuple[Bool[np.ndarray, "_ outputs"], ...]:
        """Predicted samples whose measurement is valid."""
        return self.run.scored
