"""The layout of a linear model: orders, delays, and the vector of its parameters."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.checks import require_known
from jaxnarx.data import Channels
from jaxnarx.errors import SpecError
from jaxnarx.settings import LinearMethod, Orders

Coefficients = Float[Array, " _"] | Float[np.ndarray, " _"]


class Polynomials(NamedTuple):
    """Coefficients by rising powers of q^-1; A, C, D and F begin with their one.

    `b[i]` acts on input i behind its delay, which is not part of it.
    """

    a: Coefficients
    b: tuple[Coefficients, ...]
    c: Coefficients
    d: Coefficients
    f: tuple[Coefficients, ...]
    constant: Float[Array, ""] | Float[np.ndarray, ""] | np.floating


@dataclasses.dataclass(frozen=True)
class Structure:
    """Orders of A, B_i, C, D, F_i, delays nk_i [samples], and whether a constant is
    there.

    `inputs` are positions among the channels' inputs. The vector of parameters holds
    a, all b, c, d, all f, and last the constant.
    """

    inputs: tuple[int, ...]
    na: int
    nb: tuple[int, ...]
    nc: int
    nd: int
    nf: tuple[int, ...]
    nk: tuple[int, ...]
    constant: bool = True

    def __post_init__(self):
        if not self.size:
            raise SpecError("the model has no parameters at all", field="na")

    @property
    def size(self) -> int:
        """Number of parameters."""
        orders = (self.na, *self.nb, self.nc, self.nd, *self.nf)
        return sum(orders) + int(self.constant)

    @property
    def is_linear(self) -> bool:
        """Whether the prediction is linear in the parameters: FIR and ARX."""
        return not (self.nc or self.nd or any(self.nf))

    @property
    def depth(self) -> int:
        """Past values that the recursion of the innovations carries."""
        return max(1, self.nc, self.nd, *self.nf)

    @property
    def longest(self) -> int:
        """Largest lag of a measured signal [samples]."""
        ends = [k + n - 1 for k, n in zip(self.nk, self.nb, strict=True)]
        return max([self.na, *ends])

    def input_lags(self, place: int) -> range:
        """Lags at which B acts on an input."""
        return range(self.nk[place], self.nk[place] + self.nb[place])

    def names(self, input_names: Sequence[str]) -> list[str]:
        """Names of the parameters; the number is the lag, `a2`, `b6(duty)`."""
        chosen = [input_names[i] for i in self.inputs]
        out = [f"a{k + 1}" for k in range(self.na)]
        for place, name in enumerate(chosen):
            out += [f"b{lag}({name})" for lag in self.input_lags(place)]
        out += [f"c{k + 1}" for k in range(self.nc)]
        out += [f"d{k + 1}" for k in range(self.nd)]
        for name, order in zip(chosen, self.nf, strict=True):
            out += [f"f{k + 1}({name})" for k in range(order)]
        return out + ["constant"] * self.constant

    def split(self, parameters: Coefficients) -> Polynomials:
        """The polynomials in the vector of parameters; no constant is zero.

        NumPy in, NumPy out: on the host nothing needs to be compiled.
        """
        xp = np if isinstance(parameters, np.ndarray) else jnp
        ends = np.cumsum([0, self.na, *self.nb, self.nc, self.nd, *self.nf]).tolist()
        one = xp.ones(1, parameters.dtype)
        parts = [parameters[a:b] for a, b in itertools.pairwise(ends)]
        last = xp.zeros((), parameters.dtype)
        inputs = len(self.inputs)
        a, b, c, d, f = (
            parts[0],
            parts[1 : 1 + inputs],
            parts[1 + inputs],
            parts[2 + inputs],
            parts[3 + inputs :],
        )
        a, c, d, *f = (xp.concatenate([one, tail]) for tail in (a, c, d, *f))
        if self.constant:
            last = parameters[-1]
        return Polynomials(a, tuple(b), c, d, tuple(f), last)

    def join(self, p: Polynomials) -> Coefficients:
        """The vector of parameters with these polynomials."""
        xp = np if isinstance(p.a, np.ndarray) else jnp
        parts = [p.a[1:], *p.b, p.c[1:], p.d[1:], *(f[1:] for f in p.f)]
        last = [xp.reshape(p.constant, 1)] if self.constant else []
        return xp.concatenate([*parts, *last])


def make_structure(method: LinearMethod, channels: Channels) -> Structure:
    """The layout that the settings ask for, with these channels."""
    names = channels.input_names
    nb = orders_by_input(method.nb, names, "nb")
    used = tuple(i for i, n in enumerate(nb) if n is not None)

    def orders(field: str) -> tuple[int, ...]:
        given = orders_by_input(getattr(method, field, 0), names, field)
        missing = [names[i] for i in used if given[i] is None]
        if missing:
            raise SpecError(f"{field} says nothing of {missing[0]!r}", field=field)
        return tuple(int(given[i] or 0) for i in used)

    return Structure(
        used,
        int(getattr(method, "na", 0)),
        orders("nb"),
        int(getattr(method, "nc", 0)),
        int(getattr(method, "nd", 0)),
        orders("nf"),
        orders("nk"),
        method.constant,
    )


def orders_by_input(
    orders: Orders, names: Sequence[str], field: str
) -> list[int | None]:
    """An order for every input; None for those a mapping leaves out."""
    if isinstance(orders, Mapping):
        for name in orders:
            require_known(
                name, names, field, f"{field} names {name!r}, which is not an input"
            )
        return [orders.get(name) for name in names]
    if isinstance(orders, Sequence):
        if len(orders) != len(names):
            raise SpecError(
                f"{field} holds {len(orders)} orders for {len(names)} input(s) "
                f"({', '.join(names)}); give one for each, or one number for all",
                field=field,
            )
        return list(orders)
    return [orders] * len(names)
