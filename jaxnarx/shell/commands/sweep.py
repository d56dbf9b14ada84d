"""The command `sweep`: many engines, many settings. No jax here."""

import dataclasses

from tyro.conf import Positional

from jaxnarx.shell.commands.annotations import Description, Flag, Folder


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Identify many engines under many settings, in a folder that can be continued.

    The description (TOML) names engines, the identification and the cases. Every
    finished chunk is a file of the run folder: give the same command again to continue
    a sweep that was stopped, or run it in several terminals at once to share the work.
    A fit that fails is a row with its status. The rows are table.parquet and table.csv.

    Example:
        jaxnarx sweep ridge.toml --folder runs/ridge --workers 2

    A small description, ridge.toml:
        [data]
        bed = "pfi-dyno"
        count = 16
        spread = 0.05
        [identification.pool]
        outputs = ["MAP"]
        [identification.grow]
        method = "lolimot"
        scheduling = ["speed[t]"]
        [cases]
        refine.ridge = [1e-6, 1e-4]
        refine.train = ["coefficients", "joint"]

    In place of bed: engines = ["engines/*.toml"], descriptions of measured ones. In
    place of [cases]: [random] with count, seed and ranges as ["log", 1e-6, 1e-2]. The
    sections of [identification] are those of `jaxnarx identify --settings`. In place of
    both: [fleet] with prior = "prior.fleet" and samples = [10, 20, 50] calibrates every
    engine from the first samples of its first record.
    """

    description: Positional[Description]
    """TOML description of the sweep."""
    folder: Folder = None
    """Run folder; default: runs/ and the description's name."""
    workers: int = 1
    """Processes, each on a core of its own."""
    chunk: int = 32
    """Fits of a chunk; what is in flight when the sweep stops is lost."""
    new_run: Flag = False
    """Begin anew; an earlier sweep in the folder is set aside, not removed."""
