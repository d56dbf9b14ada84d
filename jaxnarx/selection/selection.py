"""The chosen terms of every output, in order of choice."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.errors import SpecError
from jaxnarx.regressors import Pool


class Selection(eqx.Module):
    """Terms of `pool` in order of choice, one row per modelled output.

    `err` is the error reduction ratio of each term, a share of the output's (weighted)
    sum of squares; `coefficient` the least-squares value for gain-scaled signals with
    all chosen terms in the model; slots past the end have `used` False.
    """

    pool: Pool
    index: Int[np.ndarray, "outputs slots"]
    used: Bool[np.ndarray, "outputs slots"]
    err: Float[np.ndarray, "outputs slots"]
    coefficient: Float[np.ndarray, "outputs slots"]
    gain: Float[np.ndarray, " signals"]

    def terms(self, output: int = 0) -> list[int]:
        """Pool indices of the terms of one modelled output, in order of choice."""
        return self.index[output][self.used[output]].tolist()

    @property
    def names(self) -> list[str]:
        """Texts of the chosen terms in order, for a selection with one output."""
        if len(self.pool.outputs) > 1:
            raise SpecError(
                "this selection has several outputs; ask `names_of(output)`",
                field="names",
            )
        return [self.pool.name(term) for term in self.terms(0)]

    def names_of(self, output: str) -> list[str]:
        """Texts of the chosen terms of the named output, in order of choice."""
        channels = self.pool.channels
        outputs = [channels.output_names[o] for o in self.pool.outputs]
        if output not in outputs:
            raise SpecError(
                f"no modelled output {output!r}; have {outputs}", field="output"
            )
        return [self.pool.name(term) for term in self.terms(outputs.index(output))]
