"""Identification of many engines as one compiled program."""

from jaxnarx.sweep.identify._identify_each import identify_each
from jaxnarx.sweep.identify.restore_network import network_of
from jaxnarx.sweep.identify.rows import score_names
from jaxnarx.sweep.identify.work import IdentificationWork

__all__ = ["IdentificationWork", "identify_each", "network_of", "score_names"]
