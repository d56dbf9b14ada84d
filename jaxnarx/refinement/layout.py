"""The trained parameters as one vector without bounds.

Coefficients enter as they are; a parameter with limits a < p < b as p = a + (b - a)
sigma(u), so that every step of a solver stays inside. The derivative of that map turns
gradients by physical parameters into gradients by u.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program, twin
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, OutputModel, tied_outputs
from jaxnarx.refinement.initial import Initial
from jaxnarx.regressors import Centring


@guard_arguments
def freeze(
    network: Network, *, coefficients: bool = True, partition: bool = True
) -> Network:
    """The parameters that a refinement trains, whole kinds of them, as a tree of
    booleans.

    True leaves are the coefficients and, for outputs with several local models, the
    parameters of the validity function; either kind is switched off by its flag.
    """
    tree = jax.tree.map(lambda _: False, network)
    models = tuple(
        _trained_leaves(
            model, coefficients, partition and int(np.asarray(model.active).sum()) > 1
        )
        for model in network.models
    )
    return eqx.tree_at(lambda n: n.models, tree, models)


def _trained_leaves(
    model: OutputModel, coefficients: bool, partition: bool
) -> OutputModel:
    """One output's tree of booleans."""
    off = jax.tree.map(lambda _: False, model)
    on = [coefficients, *(partition for _ in model.validity.trained)]
    return eqx.tree_at(_trainable, off, on)


def _trainable(model: OutputModel) -> list:
    """The fields that may be trained: the coefficients, then the validity's own."""
    return [model.local.coefficient, *model.validity.parameters]


def _pieces(tree: Network) -> list[list]:
    """Leaves that may be trained, for each output."""
    return [_trainable(m) for m in tree.models]


def _trainable_leaves(network: Network) -> list:
    return [leaf for output in _pieces(network) for leaf in output]


FEW_SLOTS_SHARE = 0.5
"""Share of the places for coefficients that are in use, from which on the others stand
in the vector too: a program of its own for every pattern would cost more."""
LIMIT_MARGIN = 1e-3
"""Share of its range that a bounded parameter keeps from its limits: at a limit the
slope vanishes and it could never leave."""


class Layout(eqx.Module):
    """Places a vector of trained parameters in a network, and back.

    `low` and `high` are the limits of every entry, infinite where there are none. With
    `initial` the offsets of the records' initial conditions follow the network's
    parameters. With `back` an output's coefficients theta stand in the vector as psi,
    theta = psi back for every local model: those of columns without the offsets of
    channels that are far from zero.
    """

    base: Network
    low: Float[Array, " params"]
    high: Float[Array, " params"]
    chosen: tuple[tuple[bool, ...], ...] = eqx.field(static=True)
    initial: Initial | None = None
    back: tuple[Float[Array, "_ _ _"], ...] | None = None
    owners: tuple[int, ...] = eqx.field(static=True, default=())
    """For every output the one whose gates it shares, itself where it has its own;
    empty where all have."""
    slots: tuple[Int[Array, " _"] | None, ...] = ()
    """For every output the places of the coefficients that stand in the vector, where
    few are in use; None for all."""
    shared_terms: bool = eqx.field(static=True, default=False)
    """Whether all that is computed has the same terms and gates, all of them trained
    (`shared_terms.shares_terms`)."""

    @property
    def nameless(self) -> "Layout":
        """Copy with a network without names, so that names are no part of a program."""
        return twin(self, base=self.base.nameless)

    @property
    def parameters(self) -> int:
        """Number of the network's own parameters, which come first."""
        return self.low.shape[0] - (0 if self.initial is None else self.initial.size)

    def begin(
        self, u: Float[Array, " params"], measured: Float[Array, "r time outputs"]
    ) -> Float[Array, "r time outputs"]:
        """Measured outputs with estimated initial conditions in their place."""
        if self.initial is None:
            return measured
        return self.initial.begin(u[self.parameters :], measured)

    @program
    def gather(self, network: Network) -> Float[Array, " params"]:
        """The trained parameters of `network` as a vector in solver coordinates."""
        p = self.flat(self._multiply_coefficients(network, jnp.linalg.inv))
        bounded = jnp.isfinite(self.low)
        low = jnp.where(bounded, self.low, 0.0)
        span = jnp.where(bounded, self.high - self.low, 1.0)
        share = jnp.clip((p - low) / span, LIMIT_MARGIN, 1 - LIMIT_MARGIN)
        share = jnp.where(bounded, share, 0.5)
        return jnp.where(bounded, jnp.log(share / (1 - share)), p)

    @program
    def wall(self) -> Float[Array, " params"]:
        """Largest useful magnitude of each coordinate: where a limit is EDGE away."""
        edge = jnp.log((1 - LIMIT_MARGIN) / LIMIT_MARGIN)
        return jnp.where(jnp.isfinite(self.low), edge, jnp.inf).astype(self.low.dtype)

    def physical(self, u: Float[Array, " params"]) -> Float[Array, " params"]:
        """Parameters from solver coordinates."""
        bounded = jnp.isfinite(self.low)
        low = jnp.where(bounded, self.low, 0.0)
        span = jnp.where(bounded, self.high - self.low, 1.0)
        return jnp.where(bounded, low + span * jax.nn.sigmoid(u), u)

    @program
    def slope(self, u: Float[Array, " params"]) -> Float[Array, " params"]:
        """Derivative of `physical`, entry by entry."""
        return jax.jvp(self.physical, (u,), (jnp.ones_like(u),))[1]

    def place(self, u: Float[Array | np.ndarray, " params"]) -> Network:
        """The network with these parameters."""
        return eqx.tree_at(_trainable_leaves, self.base, self._leaves(u))

    @program
    def _leaves(self, u: Float[Array, " params"]) -> list:
        """The trainable leaves with these parameters."""
        p = self.physical(u)
        new: list[list] = []
        start = 0
        for output, keep in zip(_pieces(self.base), self.chosen, strict=True):
            slots = self._slots(len(new))
            own = []
            for n, (leaf, trained) in enumerate(zip(output, keep, strict=True)):
                if not trained:
                    own.append(leaf)
                elif n == 0 and slots is not None:
                    value = p[start : start + slots.size]
                    own.append(
                        leaf.reshape(-1).at[slots].set(value).reshape(leaf.shape)
                    )
                    start += slots.size
                else:
                    own.append(p[start : start + leaf.size].reshape(leaf.shape))
                    start += leaf.size
            new.append(own)
        for o, owner in enumerate(self.owners):
            if owner != o:
                new[o][1:] = new[owner][1:]
        leaves = [leaf for own in new for leaf in own]
        placed = eqx.tree_at(_trainable_leaves, self.base, leaves)
        return _trainable_leaves(self._multiply_coefficients(placed, lambda back: back))

    def _multiply_coefficients(
        self, network: Network, matrix: Callable[[Array], Array]
    ) -> Network:
        """Multiply the outputs' trained coefficients by a matrix made of `back`."""
        if self.back is None:
            return network
        models = []
        for model, keep, back in zip(
            network.models, self.chosen, self.back, strict=True
        ):
            if keep[0]:
                value = model.local.coefficient
                value = jnp.einsum("ms,mst->mt", value, matrix(back))
                model = eqx.tree_at(lambda m: m.local.coefficient, model, value)
            models.append(model)
        return eqx.tree_at(lambda n: n.models, network, tuple(models))

    def by_vector(
        self, output: int, leaf: Float[Array, "models slots rows"]
    ) -> Float[Array, "models slots rows"]:
        """Derivatives by the vector's entries from those by coefficients."""
        if self.back is None:
            return leaf
        return jnp.einsum("mst,mtr->msr", self.back[output], leaf)

    def _slots(self, output: int) -> Int[Array, " _"] | None:
        return self.slots[output] if self.slots else None

    def rows_of(
        self, output: int, leaves: list[Float[Array, "*shape rows"]]
    ) -> list[Float[Array, "_ rows"]]:
        """Rows of the trained parameters of an output, from arrays shaped like its
        trainable leaves."""
        found = []
        for n, (leaf, kept) in enumerate(zip(leaves, self.chosen[output], strict=True)):
            if kept:
                flat, slots = leaf.reshape(-1, leaf.shape[-1]), self._slots(output)
                found.append(flat if n or slots is None else flat[slots])
        return found

    def flat(self, network: Network) -> Float[Array, " params"]:
        """The trained parameters of `network` as they stand; zeros for offsets."""
        own = _concatenate(_pieces(network), self.chosen, self.slots)
        return jnp.pad(own, (0, self.low.shape[0] - own.shape[0]))

    def coefficients(self) -> Int[np.ndarray, " _"]:
        """Positions of the local models' coefficients in the vector; host only."""
        at = []
        pairs = zip(self.spans(), self._sizes(), self.chosen, strict=True)
        for (start, _), sizes, keep in pairs:
            if keep[0]:
                at.append(np.arange(start, start + sizes[0]))
        return np.concatenate([np.arange(0), *at])

    def partition(self) -> Int[np.ndarray, " _"]:
        """Positions of the validity functions' parameters in the vector; host only."""
        own = np.arange(self.parameters)
        return np.setdiff1d(own, self.coefficients())

    def shared(self, output: int) -> tuple[int, tuple[bool, ...]] | None:
        """Where the gates begin in the vector that an output shares with another, and
        which of their fields are trained; None where it has its own."""
        owner = self.owners[output] if self.owners else output
        if owner == output:
            return None
        keep = self.chosen[owner]
        start = self.spans()[owner][0] + self._sizes()[owner][0]
        return start, keep[1:]

    def spans(self) -> list[tuple[int, int]]:
        """Start and stop of each output's parameters in the vector."""
        ends = np.cumsum([0, *map(sum, self._sizes())]).tolist()
        return list(zip(ends[:-1], ends[1:], strict=True))

    def _sizes(self) -> list[list[int]]:
        """How many entries of the vector each trainable leaf has, by output."""
        found = []
        pairs = zip(_pieces(self.base), self.chosen, strict=True)
        for o, (output, keep) in enumerate(pairs):
            sizes = [leaf.size * k for leaf, k in zip(output, keep, strict=True)]
            slots = self._slots(o)
            if keep[0] and slots is not None:
                sizes[0] = slots.size
            found.append(sizes)
        return found


def _concatenate(pieces, chosen, slots=()) -> Float[Array, " params"]:
    leaves = []
    for o, (output, keep) in enumerate(zip(pieces, chosen, strict=True)):
        own = slots[o] if slots else None
        for n, (leaf, kept) in enumerate(zip(output, keep, strict=True)):
            if kept:
                flat = leaf.reshape(-1)
                leaves.append(flat if n or own is None else flat[own])
    if not leaves:
        raise SpecError("nothing is trainable", field="trainable")
    return jnp.concatenate(leaves)


def make_layout(
    network: Network,
    trainable: Network | None,
    width_band: tuple[float | int, float | int],
    initial: Initial | None = None,
    *,
    centred: bool = False,
    every: bool = False,
    dense: bool = False,
) -> Layout:
    """Layout of the leaves that are True in `trainable` (default: all with an effect).

    `centred` frees the vector's coefficients of the offsets of channels that are far
    from zero, where there are any, and with `every` of all channels' offsets and
    spreads; host only. With `dense`, host only too, coefficients that no term uses have
    no entry where most are such. Only coefficients and validity functions can be
    trained; a True elsewhere raises `SpecError`.
    """
    tree = freeze(network) if trainable is None else trainable
    flags = jax.tree.structure(tree) == jax.tree.structure(network)
    if not flags or not all(isinstance(k, bool) for k in jax.tree.leaves(tree)):
        raise SpecError(
            "trainable must be a tree of booleans with the structure of the network; "
            "make it with `freeze`",
            field="trainable",
        )
    chosen = tuple(tuple(bool(k) for k in output) for output in _pieces(tree))
    elsewhere = eqx.tree_at(
        _trainable_leaves, tree, [False] * len(_trainable_leaves(tree))
    )
    if any(bool(k) for k in jax.tree.leaves(elsewhere)):
        raise SpecError(
            "only coefficients and validity functions can be trained",
            field="trainable",
        )
    more = 0 if initial is None else initial.size
    owners = tied_outputs([model.validity for model in network.models])
    chosen = tuple(
        keep if owner == o else (keep[0], *(False for _ in keep[1:]))
        for o, (keep, owner) in enumerate(zip(chosen, owners, strict=True))
    )
    slots = _used_slots(network) if dense else ()
    low, high = _bounds(network, width_band, chosen, more, slots)
    back = _backs(network, every) if centred or every else None
    if owners == tuple(range(len(owners))):
        owners = ()
    return Layout(network, low, high, chosen, initial, back, owners, slots)


def _used_slots(network: Network) -> tuple[Int[Array, " _"] | None, ...]:
    """The places of coefficients in use, by output, where few are; empty where there is
    no such output."""
    found = []
    for model in network.models:
        used = np.asarray(model.local.used).reshape(-1)
        few = used.sum() <= FEW_SLOTS_SHARE * used.size
        found.append(jax.device_put(np.flatnonzero(used)) if few else None)
    return () if all(one is None for one in found) else tuple(found)


@program
def _bounds(
    network: Network,
    width_band: tuple[float | int, float | int],
    chosen: tuple[tuple[bool, ...], ...],
    more: int,
    slots: tuple[Int[Array, " _"] | None, ...],
) -> list[Float[Array, " params"]]:
    """Lower and upper limits of what is trained, and of so many offsets behind it."""
    limits = [m.validity.limits(width_band) for m in network.models]
    found = []
    for side, sign in enumerate((-jnp.inf, jnp.inf)):
        pieces = [
            [jnp.full_like(m.local.coefficient, sign), *limit[side].parameters]
            for m, limit in zip(network.models, limits, strict=True)
        ]
        own = _concatenate(pieces, chosen, slots)
        found.append(jnp.pad(own, (0, more), constant_values=sign))
    return found


def _backs(network: Network, every: bool) -> tuple[Float[Array, "_ _ _"], ...] | None:
    """The maps from coefficients of columns without offsets to those of terms, by
    output."""
    centre = Centring.from_ranges(
        np.asarray(network.low),
        np.asarray(network.high),
        np.asarray(network.gain),
        network.variables,
        every=every,
    )
    if centre is None:
        return None
    backs = []
    for model in network.models:
        local = model.local
        used, index = np.asarray(local.used), np.asarray(local.index)
        back = np.tile(np.eye(used.shape[1]), (len(used), 1, 1))
        for m, slots in enumerate(used):
            at = np.flatnonzero(slots)
            if at.size:
                terms = np.asarray(local.factor)[index[m, at]]
                back[m][np.ix_(at, at)] = centre.reduce(terms)[0]
        backs.append(jnp.asarray(back, local.coefficient.dtype))
    return tuple(backs)
