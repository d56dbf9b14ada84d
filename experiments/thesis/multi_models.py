"""What the experiments on multi-model networks share: data, scores, rows, tables."""

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from neural import Budget, Lesson, Neural, neural_run, neural_size, train

from jaxnarx import Channel, Dataset, Network, Pool, predict, simulate
from jaxnarx.evaluation import cost
from jaxnarx.metrics import scores
from jaxnarx.models import Boxes, LocalModels, OutputModel
from jaxnarx.simulation import Trajectories

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import record  # noqa: E402 # pyright: ignore[reportMissingImports]

PARTS = ("identification", "validation", "test")
"""Records of every data set. Nothing is chosen by the last."""
MODES = {"one_step": predict, "free_run": simulate}


def parsed(description: str, smoke: str) -> argparse.Namespace:
    """Flags of an experiment; a smoke run leaves the repository's results alone."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--smoke", action="store_true", help=smoke)
    parser.add_argument("--results", metavar="DIR", help="folder for what is written")
    options = parser.parse_args()
    if options.results is None:
        own = Path(__file__).with_name("results")
        options.results = tempfile.mkdtemp(prefix="jaxnarx-") if options.smoke else own
    options.results = Path(options.results)
    return options


class Rows:
    """Rows of an experiment in `folder/name.json`, kept as soon as they are there.

    Rows of one `key` come together; a key that the file already has is not done again.
    """

    def __init__(self, name: str, folder: Path):
        path = folder / f"{name}.json"
        self.name, self.folder = name, folder
        self.rows: list[dict[str, Any]] = []
        if path.exists():
            self.rows = json.loads(path.read_text(encoding="utf-8"))["figures"]["rows"]

    def add(self, key: Mapping[str, Any], make: Callable[[], list[dict]]) -> None:
        """The rows that `make` gives, each with the entries of `key`."""
        if any(all(row.get(k) == v for k, v in key.items()) for row in self.rows):
            return
        made = make()
        self.rows += [{**key, **row} for row in made]
        self.write()
        for row in made:
            free = row["validation"]["free_run"]
            text = " ".join(map(str, key.values()))
            print(
                f"{text}: {row['series']}, validation R2 {free['r2']:.3f}, "
                f"{row['seconds']} s",
                flush=True,
            )

    def write(self, **figures: Any) -> None:
        """Rows behind what sums them up; terms and regions of the first seed only."""
        long = ("terms", "regions")
        self.rows = [
            {k: v for k, v in row.items() if row["seed"] == 0 or k not in long}
            for row in self.rows
        ]
        record(self.name, {**figures, "rows": self.rows}, folder=self.folder)


def chosen(
    data: Dataset, inputs: Sequence[Channel], output: Channel, names: Mapping[str, str]
) -> Dataset:
    """Signals of a bed as inputs and one output; `names` are the bed's own names."""
    own = [c.name for c in data.channels.all]
    places = [own.index(names[c.name]) for c in (*inputs, output)]
    tables = [np.concatenate([r.u, r.y], axis=1)[:, places] for r in data]
    return Dataset.from_arrays(
        [table[:, :-1] for table in tables],
        [table[:, -1:] for table in tables],
        inputs=list(inputs),
        outputs=[output],
        sample_time=data.sample_time,
        names=data.names,
    )


def errors(data: Dataset, run: Trajectories) -> dict[str, Any]:
    """Pooled metrics of a run of one output, and whether a record has diverged."""
    columns = [np.concatenate(a) for a in (run.outputs, run.scored)]
    found = scores(np.concatenate([r.y for r in data]), *columns)
    kept = {k: float(f"{found[k][0]:.6g}") for k in ("r2", "fit", "nmse")}
    kept["samples"] = int(found["samples"][0])
    return kept | {"diverged": bool(np.any(run.diverged))}


def judged(network: Network, data: Dataset) -> dict[str, dict[str, Any]]:
    """Errors one step ahead and in the free run."""
    network = padded(network)
    return {mode: errors(data, run(network, data).value) for mode, run in MODES.items()}


def judged_neural(model: Neural, data: Dataset) -> dict[str, dict[str, Any]]:
    """The same of a perceptron."""
    return {
        mode: errors(data, neural_run(model, data, one_step=mode == "one_step"))
        for mode in MODES
    }


def padded(network: Network, terms: int = 48, slots: int = 12) -> Network:
    """The same network with empty entries, so that few programs are compiled.

    Distinct terms and those of a local model are filled up to multiples.
    """

    def filled(a, *multiples):
        wide = [(0, -n % m) for n, m in zip(a.shape, multiples, strict=True)]
        return jnp.pad(a, wide)

    locals_ = [model.local for model in network.models]
    wider = [
        LocalModels(
            filled(local.factor, terms, 1),
            *(
                filled(a, 1, slots)
                for a in (local.index, local.used, local.coefficient)
            ),
        )
        for local in locals_
    ]
    return eqx.tree_at(lambda n: [m.local for m in n.models], network, wider)


def parts(data: Dataset, judge: Callable[[Dataset], dict]) -> dict[str, Any]:
    """What `judge` says of validation and test record."""
    return {name: judge(data[i : i + 1]) for i, name in enumerate(PARTS) if i}


def spread(values: Sequence[float]) -> dict[str, Any]:
    """Least, median and largest of the seeds."""
    return {
        "least": min(values),
        "median": float(np.median(values)),
        "largest": max(values),
    }


def sizes(network: Network) -> dict[str, int]:
    """Regressors, and the arithmetic of one sample.

    `multiplications` are those of the terms alone, as the thesis counts them: one for a
    linear term, two for a product of two variables, in each local model that has it;
    `all` are those of the exported model, which forms common products once.
    """
    found = cost(network)
    return {
        "parameters": found.parameters,
        "regressors": found.regressors,
        "multiplications": sum(map(_term_multiplications, network.models)),
        "all": found.total.multiplications,
        "exponentials": found.total.exponentials,
    }


def _term_multiplications(model: OutputModel) -> int:
    """Thesis, section 6.3: variables of every term of the active local models; with
    boxes one of them acts at a time, and the costliest counts."""
    variables = np.count_nonzero(np.asarray(model.local.factor), axis=1)
    index, used = np.asarray(model.local.index), np.asarray(model.local.used)
    counts = [
        int(variables[np.unique(index[m, used[m]])].sum())
        for m in np.flatnonzero(np.asarray(model.active))
    ]
    return max(counts) if isinstance(model.validity, Boxes) else sum(counts)


def perceptrons(
    pool: Pool, data: Dataset, *, width: int, seed: int, budget: Budget | None = None
) -> list[dict]:
    """Rows of a perceptron, trained one step ahead and then in the free run."""
    begin = time.perf_counter()
    lesson = Lesson(pool, data[:1], data[1:2], width, jax.random.key(seed))
    (models,) = train([lesson], budget)
    seconds = round(time.perf_counter() - begin, 1)
    return [
        {
            "series": f"MLP {kind}",
            "cost": neural_size(model),
            "seconds": seconds,
            **parts(data, lambda d, model=model: judged_neural(model, d)),
        }
        for kind, model in models.items()
    ]


def table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    """Rows as text; `columns` gives the format of each, and its width with it."""
    cells = [[_cell(row.get(k), form) for k, form in columns.items()] for row in rows]
    lines = [list(columns), *cells]
    width = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            text.ljust(w) if not form else text.rjust(w)
            for text, w, form in zip(line, width, columns.values(), strict=True)
        )
        for line in lines
    )


def _cell(value: Any, form: str) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    return format(value, form)
