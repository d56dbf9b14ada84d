"""Policies for inputs beyond their trained ranges, and words for them."""

from typing import NamedTuple

FLAG, HOLD, LINEAR, NAN = OUTSIDE = "flag", "hold", "linear", "nan"
"""Policies for inputs beyond their trained ranges: go on as they are, stay at the edge,
or go on from the edge to first order; or nothing is reported of them."""


class Words(NamedTuple):
    """A policy for inputs beyond their trained ranges: as a sentence, behind the ranges
    themselves, and behind a share of samples."""

    sentence: str
    behind_ranges: str
    behind_share: str


OUTSIDE_WORDS = {
    FLAG: Words(
        "Inputs beyond their trained ranges are taken as they are",
        "Beyond that it extrapolates",
        "where the model extrapolates",
    ),
    HOLD: Words(
        "Inputs stay at the edge of their trained ranges",
        "Beyond that inputs are held at its edge",
        "at whose edge the model's limits hold its inputs",
    ),
    LINEAR: Words(
        "Beyond the trained ranges of the inputs the model goes on to first order",
        "Beyond that it goes on in a straight line",
        "from whose edge the model goes on to first order",
    ),
    NAN: Words(
        "Beyond the trained ranges of the inputs outputs are NaN",
        "Beyond that it gives no number",
        "of which the model says nothing",
    ),
}
