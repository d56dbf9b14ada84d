"""Sizes that programs are made for: one program serves all within a few per cent."""

LEAST_STEP = 32
"""Smallest step between sizes."""
COARSE_SIZES_END, COARSE_PER_OCTAVE, FINE_PER_OCTAVE = 1024, 2, 16
"""Up to `COARSE_SIZES_END` there are two sizes an octave, for there compilation costs
more than any run; beyond it 16."""


def bucket(size: int) -> int:
    """The size rounded up to the next one that programs are made for.

    A compiled program fits one size of arrays. The added samples have weight zero and
    no effect, so that one sample more compiles nothing anew: 400 and 480 give 512,
    1,800 gives 1,856, and 100,000 gives 102,400.
    """
    octave = 1 << max(size, 1).bit_length() - 1
    step = max(
        octave // (COARSE_PER_OCTAVE if size <= COARSE_SIZES_END else FINE_PER_OCTAVE),
        LEAST_STEP,
    )
    return -(-size // step) * step
