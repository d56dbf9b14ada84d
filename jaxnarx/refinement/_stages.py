"""The order of a refinement, for the verb and for sweeps.

Windows start from measured outputs: where these are noisy, least squares in them is
biased, and a partition that moves there adapts to biased coefficients and does not come
back (five to seven times the error on two of Nelles' four processes). So the
coefficients go first, through the windows and on full records, and the partition moves
on full records alone.
"""

from collections.abc import Sequence
from typing import NamedTuple


class Stage(NamedTuple):
    """A horizon (None: the full record), its steps, and what is trained."""

    horizon: int | None
    steps: int
    only_coefficients: bool = False


def stages(
    horizons: Sequence[int], window_steps: int, steps: int, *, staged: bool
) -> list[Stage]:
    """Windows that grow, then full records.

    Staged: the coefficients alone in the windows and for up to `window_steps` on the
    full record, then everything; else everything from the first window. The last stage
    begins at the best network by validation so far.
    """
    before = [Stage(h, window_steps, staged) for h in horizons]
    if staged and steps:
        before.append(Stage(None, min(window_steps, steps), True))
    return [*before, Stage(None, steps)]
