"""Lagged variables, pools of polynomial terms, and how they read as text."""

from jaxnarx.regressors.columns import record_columns, row_columns
from jaxnarx.regressors.filtering import FilterSystem, realise
from jaxnarx.regressors.filters import (
    AbstractFilter,
    Kautz,
    Laguerre,
    LowPass,
    Orthonormal,
    filter_from_dict,
    filter_to_dict,
    kautz_bank,
    laguerre_bank,
    low_pass_bank,
    orthonormal_bank,
    require_sampled,
)
from jaxnarx.regressors.pool import Pool, evaluate, polynomial_pool
from jaxnarx.regressors.text import (
    equation,
    parse_variable,
    term_name,
    variable_name,
    variable_names,
)
from jaxnarx.regressors.time_constants import time_constants
from jaxnarx.regressors.variables import Variables

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
    "term_name",
    "time_constants",
    "variable_name",
    "variable_names",
]
