"""The chosen terms of every output, in order of choice."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.deprecation import old_method
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page
from jaxnarx.regressors import Pool


class Selection(eqx.Module):
    """Terms of `pool` in order of choice, one row per modelled output.

    `err` is the error reduction ratio of each term, a share of the output's (weighted)
    sum of squares; `coefficient` the least-squares value for gain-scaled signals with
    all chosen terms in the model, `error` its standard error. Row n of `nested` and
    `errors` holds both for the first n + 1 terms alone, `sse` and `press` their squared
    error and that of predicting every sample from the others, `total` the output's sum
    of squares about its mean, all of gain-scaled signals; `samples` counts the rows
    used. Slots past the end have `used` False.
    """

    pool: Pool
    index: Int[np.ndarray, "outputs slots"]
    used: Bool[np.ndarray, "outputs slots"]
    err: Float[np.ndarray, "outputs slots"]
    coefficient: Float[np.ndarray, "outputs slots"]
    error: Float[np.ndarray, "outputs slots"]
    nested: Float[np.ndarray, "outputs slots slots"]
    errors: Float[np.ndarray, "outputs slots slots"]
    sse: Float[np.ndarray, "outputs slots"]
    press: Float[np.ndarray, "outputs slots"]
    total: Float[np.ndarray, " outputs"]
    samples: Int[np.ndarray, " outputs"]
    gain: Float[np.ndarray, " signals"]

    def __str__(self) -> str:
        """Every output's terms in order of choice, with their error reduction."""
        lines = []
        for o, name in enumerate(self.output_names):
            lines.append(f"{name}: {self.size(o)} of {len(self.pool.factor)} terms")
            for term, err in zip(self.terms(o), self.err[o], strict=False):
                lines.append(f"  {100 * err:8.4f} %  {self.pool.name(term)}")
        return "\n".join(lines)

    _repr_html_ = page

    def terms(self, output: int = 0) -> list[int]:
        """Pool indices of the terms of one modelled output, in order of choice."""
        return self.index[output][self.used[output]].tolist()

    def size(self, output: int = 0) -> int:
        """Number of terms of one modelled output."""
        return int(self.used[output].sum())

    @property
    def output_names(self) -> list[str]:
        """Names of the modelled outputs."""
        names = self.pool.channels.output_names
        return [names[o] for o in self.pool.outputs]

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
        if output not in self.output_names:
            raise SpecError(
                f"no modelled output {output!r}; have {self.output_names}",
                field="output",
            )
        place = self.output_names.index(output)
        return [self.pool.name(term) for term in self.terms(place)]

    def head(self, size: int) -> "Selection":
        """The first `size` terms of every output, with the coefficients they have then.

        Outputs with fewer terms keep theirs.
        """
        if size < 1:
            raise SpecError(f"size must be at least 1, got {size}", field="size")
        size = min(size, self.index.shape[1])
        last = np.maximum(np.minimum(self.used.sum(axis=1), size) - 1, 0)
        outputs = np.arange(len(self.index))
        return Selection(
            self.pool,
            self.index[:, :size],
            self.used[:, :size],
            self.err[:, :size],
            self.nested[outputs, last, :size],
            self.errors[outputs, last, :size],
            self.nested[:, :size, :size],
            self.errors[:, :size, :size],
            self.sse[:, :size],
            self.press[:, :size],
            self.total,
            self.samples,
            self.gain,
        )

    def narrow_pool(self) -> Pool:
        """A pool of the chosen terms of all outputs, in the order of the old one."""
        chosen = sorted({t for o in range(len(self.index)) for t in self.terms(o)})
        pool = self.pool
        return Pool(pool.variables, pool.factor[chosen], pool.channels, pool.outputs)

    narrowed = old_method("narrowed", "narrow_pool")
