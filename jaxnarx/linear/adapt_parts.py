"""What adaptation needs of a network: its coefficients and rows, laid out for updates.

The coefficients of the chosen local models of one output are held as groups: a group
for each model when every one is estimated on its own, one for all when jointly.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.errors import SpecError
from jaxnarx.methods.least_squares import Recursive
from jaxnarx.models import Network, OutputModel, scheduling_values
from jaxnarx.regressors import evaluate


class Rows(eqx.Module):
    """One output's regression at one sample or at many (leading axes).

    `columns`: the slots of every chosen model; `phi` their validities; `fixed` the part
    of the output that the other models give.
    """

    columns: Float[Array, "*rows models slots"]
    phi: Float[Array, "*rows models"]
    fixed: Float[Array, "*rows"]

    def predict(self, theta: Float[Array, "models slots"]) -> Float[Array, "*rows"]:
        """Scaled output with these coefficients of the chosen models."""
        local = jnp.sum(self.columns * theta, axis=-1)
        return self.fixed + jnp.sum(self.phi * local, axis=-1)


@dataclasses.dataclass(frozen=True)
class Plan:
    """Which local models of each output are adapted, and whether jointly."""

    chosen: tuple[tuple[int, ...], ...]
    joint: bool


def make_plan(network: Network, method: Recursive) -> Plan:
    """The chosen models of every output; `SpecError` for one that is not there."""
    chosen = []
    for name, model in zip(network.output_names, network.models, strict=True):
        active = np.flatnonzero(np.asarray(model.active)).tolist()
        wanted = active if method.models is None else list(method.models)
        strange = [m for m in wanted if m not in active]
        if strange:
            raise SpecError(
                f"{name} has no local model {strange[0]}; its models are "
                f"{', '.join(map(str, active))} (counted from 0)",
                field="models",
            )
        chosen.append(tuple(wanted))
    return Plan(tuple(chosen), method.estimation == "joint")


def output_rows(
    model: OutputModel,
    chosen: tuple[int, ...],
    v: Float[Array, "vars *rows"],
    x: Float[Array, "dims *rows"],
) -> Rows:
    """Rows of one output from its lagged and scheduling variables."""
    local, at = model.local, np.array(chosen)
    terms = evaluate(local.factor, v)
    phi = model.validity(scheduling_values(model, x), model.active)
    tail = (1,) * (v.ndim - 1)
    used = local.used[at].reshape(*local.used[at].shape, *tail)
    columns = jnp.where(used, terms[local.index[at]], 0.0)
    rest = local.dense().at[at].set(0.0)
    fixed = jnp.sum(phi * jnp.tensordot(rest, terms, axes=1), axis=0)
    return Rows(
        jnp.moveaxis(columns, (0, 1), (-2, -1)), jnp.moveaxis(phi[at], 0, -1), fixed
    )


def coefficients(
    model: OutputModel, chosen: tuple[int, ...]
) -> Float[Array, "models slots"]:
    """Coefficients of the chosen models, zero in unused slots."""
    at = np.array(chosen)
    return jnp.where(model.local.used[at], model.local.coefficient[at], 0.0)


def place(
    network: Network, plan: Plan, theta: tuple[Float[Array, "_ _"], ...]
) -> Network:
    """The network with these coefficients; unused slots keep what they hold."""
    new = []
    for model, chosen, own in zip(network.models, plan.chosen, theta, strict=True):
        at: Int[np.ndarray, " models"] = np.array(chosen)
        local = model.local
        value = jnp.where(local.used[at], own, local.coefficient[at])
        new.append(local.coefficient.at[at].set(value))
    return eqx.tree_at(lambda n: [m.local.coefficient for m in n.models], network, new)
