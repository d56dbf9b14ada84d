"""Lagged variables, pools of polynomial terms, and how they read as text."""

from jaxnarx.regressors.pool import Pool, evaluate, polynomial_pool
from jaxnarx.regressors.text import equation, parse_variable, term_name, variable_name
from jaxnarx.regressors.variables import Variables

__all__ = [
    "Pool",
    "Variables",
    "equation",
    "evaluate",
    "parse_variable",
    "polynomial_pool",
    "term_name",
    "variable_name",
]
