"""`jaxnarx fleet`: donors, a new engine, a report."""

import functools
import json
import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Dataset, read_files, read_split
from jaxnarx.errors import DataError, DataFileError, SpecError
from jaxnarx.fleet import (
    FleetPrior,
    calibrate,
    compare_records,
    learn,
    load_prior,
    save_prior,
)
from jaxnarx.models import Network, load, save
from jaxnarx.shell import output
from jaxnarx.shell.commands import (
    FleetCalibrate,
    FleetCompare,
    FleetLearn,
    FleetReport,
)
from jaxnarx.shell.description import read_description, tell_notes
from jaxnarx.shell.fleet_page import fleet_page
from jaxnarx.shell.messages import about, count, quote_command, say, warn
from jaxnarx.shell.next_command import tell_next
from jaxnarx.shell.sweep.description import Measured, load_sweep
from jaxnarx.shell.sweep.fleet import engine_files, simulate_relatives

PRIOR_FILE, REPORT_FILE, SUMS_FOLDER = "prior.fleet", "report.html", "sums"
MODEL_FILE, CALIBRATION_FILE = "model.safetensors", "calibration.json"
KEPT_ENGINES = 64
"""Engines whose records stay in memory once they were read."""
TOLD_SHARE = 0.1
"""Share of the donors after which a line tells of progress."""


class DonorFiles(Mapping[str, Dataset | DataError]):
    """Donors by name, each read when it is asked for."""

    def __init__(self, paths: Mapping[str, Path], root: str | None):
        self.paths, self.root = paths, root
        self._read = functools.lru_cache(KEPT_ENGINES)(self._read_once)

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[str]:
        return iter(self.paths)

    def __getitem__(self, name: str) -> Dataset | DataError:
        return self._read(name)

    def _read_once(self, name: str) -> Dataset | DataError:
        try:
            split = read_split(self.paths[name], root=self.root)
        except (DataError, DataFileError, SpecError) as error:
            return DataError(str(error))
        if split.train is None:
            return DataError(f"{self.paths[name].name} has no records to train on")
        return split.train


def fleet_learn(command: FleetLearn) -> int:
    """Learn, write prior and report; returns the exit code."""
    path = Path(command.description)
    described = load_sweep(path, needed=False)
    folder = command.out or str(Path("runs") / output.slug(path.stem))
    asked: dict[str, Any] = {"gates": command.gates}
    network: Any = None if command.model is None else load(command.model)
    if network is None and described.method_given:
        network = described.method
    with about(command.description):
        if isinstance(described.data, Measured):
            donors = _donor_files(described.data, described.folder)
        else:
            made = simulate_relatives(described.data)
            donors = {n: _train(d) for n, d in made.items()}
    if network is None:
        asked["preset"] = command.preset
    marks = [PRIOR_FILE, REPORT_FILE]
    with output.run_folder(folder, "", force=command.force, marks=marks) as place:
        say(f"Learning from {count(len(donors), 'donor')}")
        found = learn(
            donors, network, folder=place / SUMS_FOLDER, progress=_tell(), **asked
        )
        prior = found.value
        save_prior(prior, place / PRIOR_FILE)
        output.write_text(place / REPORT_FILE, fleet_page(prior))
        shutil.rmtree(place / SUMS_FOLDER, ignore_errors=True)
    say(str(prior))
    if not found.is_okay:
        warn(f"{found.status_name}: {found.detail}")
    say(f"wrote {PRIOR_FILE} and {REPORT_FILE} to {folder}")
    words = ("jaxnarx", "fleet", "calibrate", str(Path(folder) / PRIOR_FILE), "NEW.csv")
    tell_next(quote_command(*words))
    return 0


def _train(data: Dataset | DataError) -> Dataset | DataError:
    """The records to train on of a simulated engine."""
    return data if isinstance(data, DataError) else data[:1]


def _donor_files(data: Measured, folder: Path) -> DonorFiles:
    """The engines that patterns find, by the names of their descriptions."""
    return DonorFiles(*engine_files(data, folder))


def _tell():
    """A function that says now and then how many donors are done."""
    last = [-1]

    def progress(event: Mapping[str, Any]) -> None:
        if event.get("verb") == "search" and (row := event.get("row")) is not None:
            error = row.status if row.free_run is None else f"{row.free_run:.4f}"
            say(f"  {row.output}, {row.family}: {error}; {event['seconds']:.0f} s")
        if event.get("verb") != "learn":
            return
        done, of = event["done"], event["of"]
        step = math.floor(done / of / TOLD_SHARE)
        if step != last[0] or done == of:
            last[0] = step
            say(f"  pass {event['pass']}: {done} of {of} donors, {of - done} remain")

    return progress


def fleet_calibrate(command: FleetCalibrate) -> int:
    """Calibrate and write the model; returns the exit code."""
    prior = load_prior(command.prior)
    data = _records(command.files, command.root, prior.network)
    marks = [MODEL_FILE, CALIBRATION_FILE]
    with output.run_folder(command.out, "", force=command.force, marks=marks) as place:
        with about(command.files[0]):
            found = calibrate(prior, data)
        with output.write_together(place) as new:
            save(found.value, new / MODEL_FILE)
            told = {"status": found.status_name, "detail": found.detail}
            told |= {k: _plain(v) for k, v in found.stats.items()}
            output.write_text(new / CALIBRATION_FILE, json.dumps(told, indent=1) + "\n")
    say(found.detail)
    for name, way in found.stats.get("way", {}).items():
        scores = found.stats["scores"]
        rest = ", ".join(f"{kind} {own[name]:.3g}" for kind, own in scores.items())
        say(f"{name}: {way} (expected NRMSE: {rest})")
    if "distance" in found.stats:
        say(
            f"{found.stats['distance']:.2g} deviations from the fleet, expected about "
            f"{found.stats['expected']:.2g}; "
            f"{100 * found.stats['learnt']:.0f} % of its spread removed"
        )
    if not found.is_okay:
        warn(f"{found.status_name}: {found.detail}")
    say(f"wrote {MODEL_FILE} and {CALIBRATION_FILE} to {command.out}")
    model = str(Path(command.out) / MODEL_FILE)
    tell_next(quote_command("jaxnarx", "simulate", model, command.files[0]))
    return 0


def fleet_compare(command: FleetCompare) -> int:
    """Tell whether both are of one engine; returns the exit code."""
    prior = load_prior(command.prior)
    parts = [
        _records((path,), command.root, prior.network)
        for path in (command.earlier, command.later)
    ]
    found = compare_records(prior, *parts)
    say(str(found.value))
    for name, change in found.value.changed.items():
        say(f"  {name}: {change:+.2g} deviations of what is known of it")
    if not found.is_okay:
        warn(f"{found.status_name}: {found.detail}")
    return 1 if found.value.same is False else 0


def _records(files: Sequence[str], root: str | None, network: Network) -> Dataset:
    """An engine's records, from files or a description."""
    if not files:
        raise SpecError("give data files or one TOML description")
    first = files[0]
    if first.lower().endswith(".toml"):
        split = read_description(first, root)
        parts = [p for p in (split.train, split.validate, split.test) if p is not None]
        return parts[0]
    wanted, step = network.channels.measured, float(network.sample_time)
    with about(first):
        data = read_files(files, wanted, sample_time=step, missing="mask")
    tell_notes(data)
    return data


def _plain(value: Any) -> Any:
    """A figure as JSON has it."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value


def fleet_report(command: FleetReport) -> int:
    """Print what a prior holds, write its page; returns the exit code."""
    prior: FleetPrior = load_prior(command.prior)
    say(str(prior))
    if command.out is not None:
        marks = [REPORT_FILE]
        out, force = command.out, command.force
        with output.run_folder(out, "", force=force, marks=marks) as place:
            output.write_text(place / REPORT_FILE, fleet_page(prior))
        say(f"wrote {REPORT_FILE} to {command.out}")
    return 0
