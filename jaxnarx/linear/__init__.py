"""Linear models: order search, fits, transfer functions, spectra, extended least
squares.
"""

from jaxnarx.linear._adapt import adapt
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
from jaxnarx.linear.state_space import StateSpace as StateSpace
from jaxnarx.linear.subspace import chain_model as chain_model
from jaxnarx.linear.subspace import identify_subspace as identify_subspace
from jaxnarx.linear.subspace import subspace_models as subspace_models
from jaxnarx.linear.transfer_function import Bode, TransferFunction
from jaxnarx.methods import (
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    GeneralLinear,
    LeastSquares,
    OutputError,
    Recursive,
)
from jaxnarx.texts import document

__all__ = [
    "ARMAX",
    "ARX",
    "Bode",
    "BoxJenkins",
    "ExtendedFit",
    "FIR",
    "GeneralLinear",
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
    "extended_least_squares",
    "fit_linear",
    "fit_noise",
    "innovations",
    "least_squares",
    "nonlinearity",
    "search_orders",
    "spectra",
]

document(
    ARMAX, ARX, FIR, BoxJenkins, GeneralLinear, LeastSquares, OutputError, Recursive
)
