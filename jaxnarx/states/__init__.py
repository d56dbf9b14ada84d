"""Models with hidden states: linear starts, products, training on the free run."""

from jaxnarx.methods import HiddenStates
from jaxnarx.states.fit import fit_states, refit_states
from jaxnarx.states.network import raised, settled, state_network
from jaxnarx.states.starts import linear_order
from jaxnarx.texts import document

__all__ = [
    "HiddenStates",
    "fit_states",
    "linear_order",
    "raised",
    "refit_states",
    "settled",
    "state_network",
]

document(HiddenStates)
