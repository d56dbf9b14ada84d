"""Linear models: order search, fits, transfer functions, spectra, extended least
squares.
"""

from jaxnarx.linear.adapt import adapt as adapt
from jaxnarx.linear.extended import ExtendedFit as ExtendedFit
from jaxnarx.linear.extended import extended_least_squares as extended_least_squares
from jaxnarx.linear.fit import fit_linear as fit_linear
from jaxnarx.linear.innovations import Innovations as Innovations
from jaxnarx.linear.innovations import innovations as innovations
from jaxnarx.linear.model import LinearModel as LinearModel
from jaxnarx.linear.noise import NoiseModel as NoiseModel
from jaxnarx.linear.noise import fit_noise as fit_noise
from jaxnarx.linear.nonlinearity import NonlinearityCheck as NonlinearityCheck
from jaxnarx.linear.nonlinearity import nonlinearity as nonlinearity
from jaxnarx.linear.order_table import OrderSearch as OrderSearch
from jaxnarx.linear.orders import search_orders as search_orders
from jaxnarx.linear.regression import Regression as Regression
from jaxnarx.linear.regression import least_squares as least_squares
from jaxnarx.linear.spectra import Spectra as Spectra
from jaxnarx.linear.spectra import spectra as spectra
from jaxnarx.linear.transfer_function import Bode as Bode
from jaxnarx.linear.transfer_function import TransferFunction as TransferFunction
