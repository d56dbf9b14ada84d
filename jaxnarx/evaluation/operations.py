"""Counts of arithmetic: what filters and the weights of each validity function take.

Constants are folded beforehand, as a code generator does: (x - c)/s is a subtraction
and a multiplication, the factor 1/2 of a Gaussian lies in its width, the scaling of
scheduling variables in centres, widths, borders and directions. Signs are free.
"""

import dataclasses
import functools
from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool

from jaxnarx.errors import SpecError
from jaxnarx.models import (
    AbstractValidity,
    Boxes,
    Compact,
    Gaussians,
    LogSigmoids,
    SigmoidTree,
)
from jaxnarx.regressors import AbstractFilter


@dataclasses.dataclass(frozen=True)
class Operations:
    """How many of each. A subtraction is an addition; a least, largest or limited value
    is a comparison for every value beyond the first."""

    multiplications: int = 0
    additions: int = 0
    exponentials: int = 0
    divisions: int = 0
    comparisons: int = 0

    def __add__(self, other: "Operations") -> "Operations":
        mine, theirs = dataclasses.astuple(self), dataclasses.astuple(other)
        return Operations(*(a + b for a, b in zip(mine, theirs, strict=True)))


NONE = Operations()


@functools.singledispatch
def weighing(
    validity: AbstractValidity, active: Bool[np.ndarray, " models"]
) -> tuple[Operations, int]:
    """(operations, numbers to store) of the weights of several active models.

    - `Gaussians`, M models in d dimensions: M d differences, scalings and squares, M (d
      - 1) sums, exponents less the largest of them (M - 1 comparisons, M
      subtractions: far away nothing else keeps the sum from zero), M exponentials, M -
      1 sums and one division of the blend by the sum.
    - `Boxes`: 2 M d distances and as many comparisons, then M - 1 for the nearest box.
    - `Compact`: the range limits each variable by 2 comparisons; each of 2 M d flanks
      is a difference, a scaling, 2 comparisons and 5 multiplications and 2 additions
      for t^3 (10 + t (6 t - 15)); 2 d - 1 products a model; then as for Gaussians a sum
      and a division, and a comparison of the sum with zero. Where no curve reaches, the
      nearest box is looked for: not counted.
    - `LogSigmoids`: M - 1 gates of a difference, a scaling and a sigmoid (exponential,
      addition, division); M - 1 differences.
    - `SigmoidTree`: a gate in use takes a product per variable its direction holds, as
      many additions, and a sigmoid. Weights go down the tree: p becomes p g and p - p
      g, one product and one difference a gate, no product at the root. A gate without
      direction gives a sum's part the same share everywhere, without a sigmoid.
    """
    raise SpecError(
        f"no rule to count the operations of {type(validity).__name__}", field="network"
    )


@weighing.register(Gaussians)
def _gaussians(validity: Gaussians, active: Bool[np.ndarray, " models"]):
    models, dims = int(active.sum()), validity.centre.shape[1]
    operations = Operations(
        multiplications=2 * models * dims,
        additions=models * (2 * dims - 1) + models + models - 1,
        exponentials=models,
        divisions=1,
        comparisons=models - 1,
    )
    return operations, 2 * models * dims


@weighing.register(Boxes)
def _boxes(validity: Boxes, active: Bool[np.ndarray, " models"]):
    models, dims = int(active.sum()), validity.low.shape[1]
    away = 2 * models * dims
    return Operations(additions=away, comparisons=away + models - 1), away


@weighing.register(Compact)
def _compact(validity: Compact, active: Bool[np.ndarray, " models"]):
    models, dims = int(active.sum()), validity.low.shape[1]
    flanks = 2 * models * dims
    operations = Operations(
        multiplications=6 * flanks + models * (2 * dims - 1),
        additions=3 * flanks + models - 1,
        divisions=1,
        comparisons=2 * dims + 2 * flanks + 1,
    )
    return operations, 3 * models * dims


@weighing.register(LogSigmoids)
def _log_sigmoids(validity: LogSigmoids, active: Bool[np.ndarray, " models"]):
    gates = int(active.sum()) - 1
    operations = Operations(
        multiplications=gates,
        additions=3 * gates,
        exponentials=gates,
        divisions=gates,
    )
    return operations, gates + 1


@weighing.register(SigmoidTree)
def _sigmoid_tree(validity: SigmoidTree, active: Bool[np.ndarray, " models"]):
    used = np.any(np.asarray(validity.path)[active] != 0, axis=0)
    gates = int(used.sum())
    held = np.asarray(validity.direction)[used] != 0
    along, moving = int(held.sum()), int(held.any(axis=1).sum())
    operations = Operations(
        multiplications=along + gates - 1,
        additions=along + moving + gates,
        exponentials=moving,
        divisions=moving,
    )
    return operations, along + gates


def filtering(pairs: Iterable[tuple[int, AbstractFilter]]) -> Operations:
    """Operations of filters (signal, filter); what they have in common counts once.

    Filters of one signal share the sections of their cascades as far as their poles are
    the same. A real section is x' = a x + b e, and e' = c x + d e where another
    section follows: two products and a sum each. A section of a complex pair takes five
    products and three sums, and three and two for e'.
    """
    chains = {(signal, filter_.sections) for signal, filter_ in pairs}
    cascades = {(s, chain[: n + 1]) for s, chain in chains for n in range(len(chain))}
    followed = {(s, chain[:-1]) for s, chain in cascades}
    total = NONE
    for signal, chain in cascades:
        pair, goes_on = bool(chain[-1].imag), (signal, chain) in followed
        total += Operations(*(5, 3) if pair else (2, 1))
        if goes_on:
            total += Operations(*(3, 2) if pair else (2, 1))
    return total
