"""Sizes that programs are made for: one program serves all within a few per cent."""

LEAST = 32
"""Smallest step between sizes."""
SHARE = 16
"""A size is rounded up by less than one part in so many, or by less than `LEAST`."""


def bucket(size: int) -> int:
    """The size rounded up to the next one that programs are made for.

    A compiled program fits one size of arrays. What is added has weight zero and no
    effect, so that a sample more compiles nothing anew: 600 gives 608, 1,800 gives
    1,856, and 100,000 gives 102,400.
    """
    step = max(1 << max(size // SHARE, 1).bit_length() - 1, LEAST)
    return -(-size // step) * step
