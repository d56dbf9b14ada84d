"""Lagged variables, pools of polynomial terms, and how they read as text."""

from jaxnarx.regressors._filter_text import filter_text as filter_text
from jaxnarx.regressors._time_constants import time_constants as time_constants
from jaxnarx.regressors.centring import Centring as Centring
from jaxnarx.regressors.columns import batch_columns as batch_columns
from jaxnarx.regressors.columns import even_places as even_places
from jaxnarx.regressors.columns import record_columns as record_columns
from jaxnarx.regressors.columns import row_columns as row_columns
from jaxnarx.regressors.filtering import FilterSystem as FilterSystem
from jaxnarx.regressors.filtering import filter_table as filter_table
from jaxnarx.regressors.filtering import realise as realise
from jaxnarx.regressors.filtering import static_gains as static_gains
from jaxnarx.regressors.filtering import system_of as system_of
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
from jaxnarx.regressors.rows import Rows as Rows
from jaxnarx.regressors.rows import regression_rows as regression_rows
from jaxnarx.regressors.rows import require_samples as require_samples
from jaxnarx.regressors.rows import row_places as row_places
from jaxnarx.regressors.text import equation as equation
from jaxnarx.regressors.text import parse_variable as parse_variable
from jaxnarx.regressors.text import term_name as term_name
from jaxnarx.regressors.text import variable_name as variable_name
from jaxnarx.regressors.text import variable_names as variable_names
from jaxnarx.regressors.variables import Variables as Variables

__all__ = [
    "AbstractFilter",
    "FilterSystem",
    "Kautz",
    "Laguerre",
    "LowPass",
    "Orthonormal",
    "Pool",
    "Variables",
    "equation",
    "evaluate",
    "filter_from_dict",
    "filter_table",
    "filter_text",
    "filter_to_dict",
    "kautz_bank",
    "laguerre_bank",
    "low_pass_bank",
    "orthonormal_bank",
    "parse_variable",
    "polynomial_pool",
    "realise",
    "record_columns",
    "require_sampled",
    "row_columns",
    "system_of",
    "term_name",
    "time_constants",
    "variable_name",
    "variable_names",
]
"""Names for users; other rooms may import every name above."""
