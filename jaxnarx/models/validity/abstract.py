"""The interface of every validity function."""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import bucket
from jaxnarx.deprecation import old_method

CENTRE_ROOM = 0.01
"""Room for a centre at the border of the range, or beyond it, in the range's units."""

Region = dict[str, dict[str, float]]
"""Region of one local model: by scheduling variable (or combination of them), its
`centre` and `width`, or what it lies `above` and `below`; physical units."""


class AbstractValidity(eqx.Module):
    """Maps points to weights of the active models, which sum to one if not said
    otherwise.

    Points are columns of scaled scheduling variables, [0, 1] the training range of
    each; samples, where there are several, are trailing axes. Active models come
    before inactive ones.
    """

    trained: ClassVar[tuple[str, ...]]
    """Fields that a refinement may move."""
    sums_to_one: ClassVar[bool] = True
    """Whether the weights of the active models sum to one; otherwise the local models
    are added up, each as far as it counts."""
    is_convex: ClassVar[bool] = False
    """Whether the weights are never negative and sum to one for all that `check` takes.

    A certificate is given to such validity functions alone. Say so of a class of your
    own where it holds; its contract tries it.
    """

    @abc.abstractmethod
    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]: ...

    @abc.abstractmethod
    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["AbstractValidity", "AbstractValidity"]:
        """Lower and upper limits of every trained field for refinement, as such trees.

        Places stay in the scheduling range; widths, or what stands for them, within a
        band of the present, as multiples.
        """

    @abc.abstractmethod
    def check(self, models: int, dims: int) -> None:
        """ValueError where the fields do not fit a number of models and dimensions."""

    @abc.abstractmethod
    def regions(
        self,
        names: Sequence[str],
        offset: Float[np.ndarray, " dims"],
        span: Float[np.ndarray, " dims"],
    ) -> list[Region]:
        """The region of each local model, in physical units x = offset + span z."""

    @property
    def parameters(self) -> list[Any]:
        """The values of the trained fields (flags, in a tree of booleans)."""
        return [getattr(self, name) for name in self.trained]

    def replace_parameters(self, values: Sequence[Array]) -> "AbstractValidity":
        """The same with these values of the trained fields."""
        return dataclasses.replace(self, **dict(zip(self.trained, values, strict=True)))

    replaced = old_method("replaced", "replace_parameters")


MOST_MODELS = 1024
"""Local models of one output that are thought of where no size tells their number."""


def count_models(validity: AbstractValidity, dims: int) -> int:
    """The number of local models that there is room for: the one `check` accepts.

    ValueError, what `check` says, where it accepts none for so many variables.
    """
    first = [leaf.shape[0] for leaf in jax.tree.leaves(validity) if leaf.ndim]
    refused = []
    for models in (*first, *range(1, MOST_MODELS + 1)):
        try:
            validity.check(models, dims)
        except ValueError as error:
            refused.append(error)
        else:
            return models
    raise refused[0]


@eqx.filter_jit
def _call(validity: AbstractValidity, z, active):
    return validity(z, active)


def weights_of(
    validity: AbstractValidity,
    z: Float[np.ndarray, "dims points"],
    active: Bool[Array, " models"] | Bool[np.ndarray, " models"],
) -> Float[np.ndarray, "models points"]:
    """Values at scaled points, on the host, by one program for many sizes; float64."""
    points = z.shape[1]
    numbers = [x for x in jax.tree.leaves(validity) if eqx.is_inexact_array(x)]
    dtype = numbers[0].dtype if numbers else z.dtype
    rounded = np.zeros((len(z), bucket(points)), dtype)
    rounded[:, :points] = z
    return np.asarray(_call(validity, rounded, active), float)[:, :points]


def column(values: Array, rows: int) -> Array:
    """`values` with as many trailing axes as there are axes of samples."""
    return values.reshape(values.shape + (1,) * rows)


def require_shape(name: str, value: Array, shape: tuple[int, ...]) -> None:
    """ValueError unless an array of a file has its size."""
    if value.shape != shape:
        raise ValueError(
            f"validities do not fit their number: {name} is {value.shape}, not {shape}"
        )
