"""float64, and the extensions that the checks are run over."""

import importlib
import os

import jax

jax.config.update("jax_enable_x64", True)

MODULES_VARIABLE = "JAXNARX_EXTENSIONS"
"""Modules to import, separated by commas."""

for module in filter(None, os.environ.get(MODULES_VARIABLE, "").split(",")):
    importlib.import_module(module.strip())
