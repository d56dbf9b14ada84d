"""Lagged variables, pools of polynomial terms, and how they read as text."""

from jaxnarx.regressors.columns import record_columns as record_columns
from jaxnarx.regressors.columns import row_columns as row_columns
from jaxnarx.regressors.filtering import FilterSystem as FilterSystem
from jaxnarx.regressors.filtering import realise as realise
from jaxnarx.regressors.filters import AbstractFilter as AbstractFilter
from jaxnarx.regressors.filters import Kautz as Kautz
from jaxnarx.regressors.filters import Laguerre as Laguerre
from jaxnarx.regressors.filters import LowPass as LowPass
from jaxnarx.regressors.filters import Orthonormal as Orthonormal
from jaxnarx.regressors.filters import filter_from_dict as filter_from_dict
from jaxnarx.regressors.filters import filter_to_dict as filter_to_dict
from jaxnarx.regressors.filters import kautz_bank as kautz_bank
from jaxnarx.regressors.filters import laguerre_bank as laguerre_bank
from jaxnarx.regressors.filters import low_pass_bank as low_pass_bank
from jaxnarx.regressors.filters import orthonormal_bank as orthonormal_bank
from jaxnarx.regressors.filters import require_sampled as require_sampled
from jaxnarx.regressors.pool import Pool as Pool
from jaxnarx.regressors.pool import evaluate as evaluate
from jaxnarx.regressors.pool import polynomial_pool as polynomial_pool
from jaxnarx.regressors.text import equation as equation
from jaxnarx.regressors.text import parse_variable as parse_variable
from jaxnarx.regressors.text import term_name as term_name
from jaxnarx.regressors.text import variable_name as variable_name
from jaxnarx.regressors.text import variable_names as variable_names
from jaxnarx.regressors.time_constants import time_constants as time_constants
from jaxnarx.regressors.variables import Variables as Variables
