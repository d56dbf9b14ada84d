"""Linear models: order search, fits, transfer functions, spectra, extended least
squares; state-space models, linear and with products of their states.
"""

from jaxnarx.docstrings import document
from jaxnarx.linear._adapt import adapt
from jaxnarx.linear._export_adaptation import export_adaptation
from jaxnarx.linear._innovations import Innovations, innovations
from jaxnarx.linear._nonlinearity import NonlinearityCheck, nonlinearity
from jaxnarx.linear._spectra import Spectra, spectra
from jaxnarx.linear.extended import ExtendedFit, extended_least_squares
from jaxnarx.linear.fit import fit_linear
from jaxnarx.linear.model import LinearModel
from jaxnarx.linear.noise import NoiseModel, fit_noise
from jaxnarx.linear.order_table import OrderSearch
from jaxnarx.linear.orders import search_orders
from jaxnarx.linear.regression import Regression, least_squares
from jaxnarx.linear.state_space.fit import fit_states, refit_states
from jaxnarx.linear.state_space.model import StateSpace as StateSpace
from jaxnarx.linear.state_space.network import (
    increase_degree,
    set_state_ranges,
    state_network,
)
from jaxnarx.linear.state_space.regions import drop_inactive as drop_inactive
from jaxnarx.linear.state_space.starts import linear_order
from jaxnarx.linear.state_space.subspace import chain_model as chain_model
from jaxnarx.linear.state_space.subspace import identify_subspace as identify_subspace
from jaxnarx.linear.state_space.subspace import subspace_models as subspace_models
from jaxnarx.linear.transfer_function import Bode, TransferFunction
from jaxnarx.settings import (
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    GeneralLinear,
    HiddenStates,
    LeastSquares,
    OutputError,
    Recursive,
)

__all__ = [
    "ARMAX",
    "ARX",
    "Bode",
    "BoxJenkins",
    "ExtendedFit",
    "FIR",
    "GeneralLinear",
    "HiddenStates",
    "Innovations",
    "LeastSquares",
    "LinearModel",
    "NoiseModel",
    "NonlinearityCheck",
    "OrderSearch",
    "OutputError",
    "Recursive",
    "Regression",
    "Spectra",
    "TransferFunction",
    "adapt",
    "export_adaptation",
    "extended_least_squares",
    "fit_linear",
    "fit_noise",
    "fit_states",
    "increase_degree",
    "innovations",
    "least_squares",
    "linear_order",
    "nonlinearity",
    "refit_states",
    "search_orders",
    "set_state_ranges",
    "spectra",
    "state_network",
]

document(
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    GeneralLinear,
    HiddenStates,
    LeastSquares,
    OutputError,
    Recursive,
)
