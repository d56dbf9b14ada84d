"""The search of `jaxnarx identify` and the commands about it. No jax here."""

import dataclasses
from typing import Annotated

from tyro.conf import Positional, arg

from jaxnarx.shell.commands.annotations import Flag, Folder, Percent, Run, optional

_NUMBERS_ARGUMENT = arg(metavar="NUMBER [NUMBER ...]", help_behavior_hint="(required)")


@dataclasses.dataclass(frozen=True)
class Automatic:
    """A search among candidates from cheap to rich, and its options."""

    preset: str = "good"
    """How much the search tries, and what it takes: quick (about a minute), good
    (minutes for every output), best (an hour and more; may add models up), ecu (the
    fewest operations within 5 % of the best) or linear (linear models only)."""
    budget: float | None = None
    """Time for the search, such as 10m, 600s or 1h, after which no further candidate is
    begun: the result then depends on the machine. Default: no limit of time, the
    preset's counts bound the search."""
    candidates: int | None = None
    """Most candidates of every output; default: the preset's."""
    states: int | None = None
    """Number of hidden states of candidates that have some, 0 for none of these;
    default: what the preset tries."""
    outputs: tuple[str, ...] = ()
    """Names of the outputs to be modelled; default: all."""


@dataclasses.dataclass(frozen=True)
class Leaderboard:
    """Show the candidates that `jaxnarx identify` has tried, finished or not.

    Best first, by output: the free run over groups of records left out with its
    standard error, the group served worst, operations of one sample, parameters.

    Example:
        jaxnarx leaderboard runs/engine-good
    """

    run: Positional[Run]
    """Folder of the search."""
    csv: Flag = False
    """Print comma-separated values, all figures in full."""


@dataclasses.dataclass(frozen=True)
class Choose:
    """Choose another candidate of a search: its model, trained on all records.

    NUMBER is that of the leaderboard; several, one for each output, become one model.
    FOLDER receives the model and a report on the records of the search.

    Example:
        jaxnarx choose runs/engine-good 7
    """

    run: Positional[Run]
    """Folder of the search."""
    numbers: Positional[Annotated[tuple[int, ...], _NUMBERS_ARGUMENT]]
    """Numbers of candidates."""
    description: Annotated[str | None, optional("DESCRIPTION")] = None
    """TOML description of the records; default: the one that RUN was made from."""
    root: Folder = None
    """Folder of the data; default: as for RUN."""
    out: Folder = None
    """Folder for model and report; default: that of RUN with the numbers behind it."""
    force: Flag = False
    """Write into a folder that already holds a model."""
    require_fit: Percent = None
    """Exit with 1 unless the pooled free-run fit of every output reaches this [%]."""
