"""What a fleet has in common, as one value and one file."""

import dataclasses
import functools
import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import ModelFileError
from jaxnarx.files import write_whole
from jaxnarx.fleet.coefficients import (
    FleetCoefficients,
    choose_coefficients,
    names_of,
    offset_and_gain,
)
from jaxnarx.fleet.population import Population
from jaxnarx.fleet.rivals import KINDS, Rivals, at_samples, expect_errors, make_rivals
from jaxnarx.formatting import align_columns, brief, count, page, some
from jaxnarx.models import Network, load, save

FORMAT = 2
"""Format of the file; 2: with errors that the samples of donors let expect."""
NETWORK_FILE, ARRAYS_FILE, HEADER_FILE = (
    "network.safetensors",
    "arrays.npz",
    "fleet.json",
)
PROMISE_SHARE = 0.5
"""How much it counts that samples tell more than the donors' did; all that they tell
less. On four virtual beds all of both chose worse than neither in some seeds."""
ARRAYS = (
    *("mean", "covariance", "noise", "colour", "scale", "estimate", "distance"),
    *("freedom", "used", "ladder", "left", "output_spread", "by_count", "alone"),
    *("expected_before", "slope", "typical"),
)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class FleetPrior:
    """A population of engines, to calibrate a new one from few samples.

    `network` is that of the donors' mean; `coefficients` are those in which engines
    differ. Of every donor there are its `estimate`, in units of `coefficients`, its
    `distance` from the others (Mahalanobis, expected about the root of `freedom`),
    whether it was `used`, and a `remark` where it was not. `ladder` holds the mean
    logarithm of the squared error, over the variance of the output, of donors that were
    calibrated by the others from `rungs` samples, by all ways of `rivals`.
    `expected_before` is the mean logarithm of the squared error that their samples let
    expect, over samples of the mean square `typical` of what coefficients move; where
    it is larger, errors are by `slope`.
    `by_count` is the same by donors of which there are only so many (`counts`), and
    `alone` are coefficients of donors by their own samples, without the others.
    `linear` says whether runs are linear in the coefficients that differ.
    `left` is the usual squared error of a donor by its own coefficients,
    `output_spread` the variance of the donors' outputs, both scaled by gains. The first
    `warm_up` samples of records count nowhere.
    """

    network: Network
    coefficients: FleetCoefficients
    population: Population
    donors: tuple[str, ...]
    estimate: Float[np.ndarray, "donors params"]
    distance: Float[np.ndarray, " donors"]
    freedom: Float[np.ndarray, " donors"]
    used: Bool[np.ndarray, " donors"]
    remark: tuple[str, ...]
    rungs: tuple[int, ...]
    ladder: Float[np.ndarray, "rungs ways outputs"]
    left: Float[np.ndarray, " outputs"]
    output_spread: Float[np.ndarray, " outputs"]
    counts: tuple[int, ...]
    by_count: Float[np.ndarray, "counts rungs ways outputs"]
    alone: Float[np.ndarray, "donors params"]
    expected_before: Float[np.ndarray, "rungs ways outputs"]
    slope: Float[np.ndarray, " outputs"]
    typical: Float[np.ndarray, "outputs params params"]
    linear: bool = True
    warm_up: int = 0
    gates: bool = False
    feedback: bool = False

    def __str__(self) -> str:
        """How many donors, what they differ in, and how well a new one is known."""
        names = self.network.output_names
        lines = [
            f"FleetPrior: {count(int(self.used.sum()), 'donor')}, "
            f"{count(len(self.coefficients.free), 'coefficient')} that differ, of "
            f"{', '.join(names)}",
            "NRMSE of a donor calibrated by the others, by samples:",
        ]
        for o, name in enumerate(names):
            table = self.expected(o)
            rows = [(name, *(f"{n}" for n in self.rungs))]
            rows += [(k, *(f"{v:.3f}" for v in table[k])) for k in KINDS]
            lines += align_columns(rows)
        apart = [
            f"{name}: {text}"
            for name, text in zip(self.donors, self.remark, strict=True)
            if text
        ]
        return "\n".join([*lines, *some(apart, 12)])

    __repr__, _repr_html_ = brief, page

    @property
    def names(self) -> list[str]:
        """Names of the coefficients that differ."""
        return names_of(self.coefficients)

    @functools.cached_property
    def rivals(self) -> Rivals:
        """The ways to calibrate an engine; made once."""
        return rivals_of(self.coefficients, self.population)

    def foretell(
        self, gram: Float[np.ndarray, "outputs params params"], samples: float | int
    ) -> Float[np.ndarray, "ways outputs"]:
        """Logarithms of squared errors, over the variance of the output, of a new
        engine calibrated by so many samples of this `gram`, by every way: those of the
        donors, more where these samples tell less than theirs, and less where they tell
        more (`PROMISE_SHARE`)."""
        given = self.population, self.typical, self.left
        expected = np.log(expect_errors(self.rivals, gram, *given))
        usual, before = (
            at_samples(self.rungs, table, samples)
            for table in (self.ladder, self.expected_before)
        )
        more = self.slope * (expected - before)
        return usual + np.where(more > 0, more, PROMISE_SHARE * more)

    def expected(self, output: int = 0) -> dict[str, Float[np.ndarray, " rungs"]]:
        """NRMSE by samples of a donor that the others calibrate, by kind: root mean
        square in the mean of logarithms, of the best weight."""
        kinds = np.array(self.rivals.kinds)
        own = np.exp(self.ladder[:, :, output] / 2)
        return {kind: own[:, kinds == kind].min(axis=1) for kind in KINDS}

    def expected_by_donors(
        self, output: int = 0
    ) -> dict[int, Float[np.ndarray, " counts"]]:
        """NRMSE of a donor that so many others calibrate, the prior's best weight, by
        samples."""
        kinds = np.array(self.rivals.kinds)
        own = np.exp(self.by_count[:, :, kinds == "prior", output] / 2).min(axis=2)
        return dict(zip(self.rungs, own.T, strict=True))

    @property
    def spread(self) -> Float[np.ndarray, " params"]:
        """Standard deviation of every coefficient over the population, in those of the
        output that it moves."""
        return np.sqrt(np.diag(np.asarray(self.population.covariance)))

    def broken(self) -> list[str]:
        """Donors that are unlike the others, or could not be used."""
        return [n for n, u in zip(self.donors, self.used, strict=True) if not u]


def rivals_of(coefficients: FleetCoefficients, population: Population) -> Rivals:
    """The ways to calibrate an engine of a population."""
    start = np.asarray(coefficients.start)[np.asarray(coefficients.free)]
    zero = -start / np.asarray(coefficients.scale)
    return make_rivals(population, offset_and_gain(coefficients), zero)


@guard_arguments
def save_prior(prior: FleetPrior, path: str | os.PathLike[str]) -> None:
    """Write a prior to one file, whole or not at all.

    Example:
        prior = jnx.fleet.learn({"one": data, "other": data}, network).value
        jnx.fleet.save_prior(prior, "line.fleet")
        again = jnx.fleet.load_prior("line.fleet")
    """
    path = Path(path)
    own = prior.coefficients
    arrays = {
        "mean": prior.population.mean,
        "covariance": prior.population.covariance,
        "noise": prior.population.noise,
        "colour": prior.population.colour,
        "scale": own.scale,
        "estimate": prior.estimate,
        "distance": prior.distance,
        "freedom": prior.freedom,
        "used": prior.used,
        "ladder": prior.ladder,
        "left": prior.left,
        "output_spread": prior.output_spread,
        "by_count": prior.by_count,
        "alone": prior.alone,
        "expected_before": prior.expected_before,
        "slope": prior.slope,
        "typical": prior.typical,
    }
    header = {
        "format": FORMAT,
        "donors": list(prior.donors),
        "remark": list(prior.remark),
        "rungs": list(prior.rungs),
        "counts": list(prior.counts),
        "linear": prior.linear,
        "warm_up": prior.warm_up,
        "gates": prior.gates,
        "feedback": prior.feedback,
    }
    held, whole = io.BytesIO(), io.BytesIO()
    np.savez(held, **{k: np.asarray(a) for k, a in arrays.items()})  # pyright: ignore[reportArgumentType]
    with zipfile.ZipFile(whole, "w") as archive:
        archive.writestr(HEADER_FILE, json.dumps(header))
        archive.writestr(ARRAYS_FILE, held.getvalue())
        archive.writestr(NETWORK_FILE, _network_bytes(prior.network, path))
    write_whole(path, whole.getvalue())


def _network_bytes(network: Network, path: Path) -> bytes:
    """The model file of a network."""
    beside = path.with_name(f".{path.name}.network")
    save(network, beside)
    try:
        return beside.read_bytes()
    finally:
        beside.unlink(missing_ok=True)


@guard_arguments
def load_prior(path: str | os.PathLike[str]) -> FleetPrior:
    """A prior from its file; ModelFileError where it is none or damaged."""
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            header = json.loads(archive.read(HEADER_FILE))
            with np.load(io.BytesIO(archive.read(ARRAYS_FILE))) as held:
                arrays = {name: held[name] for name in ARRAYS}
            network = _read_network(archive.read(NETWORK_FILE), path)
        return _restore(header, arrays, network)
    except FileNotFoundError as error:
        raise ModelFileError(f"{path}: there is no such file", path=path) from error
    except (zipfile.BadZipFile, KeyError, ValueError, OSError, EOFError) as error:
        raise ModelFileError(
            f"{path} is no fleet prior, or is damaged: {error}", path=path
        ) from error


def _read_network(content: bytes, path: Path) -> Network:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        beside = Path(folder) / NETWORK_FILE
        beside.write_bytes(content)
        try:
            return load(beside)
        except ModelFileError as error:
            raise ModelFileError(
                f"{path}: its network cannot be read: {error}", path=path
            ) from error


def _restore(
    header: dict[str, Any], arrays: dict[str, np.ndarray], network: Network
) -> FleetPrior:
    if header["format"] != FORMAT:
        raise ValueError(f"format {header['format']}, this version reads {FORMAT}")
    gates, feedback = bool(header["gates"]), bool(header["feedback"])
    own = choose_coefficients(network, gates=gates, feedback=feedback)
    scale = jnp.asarray(arrays["scale"])
    if scale.shape != own.scale.shape:
        raise ValueError("its arrays do not belong to its network")
    own = dataclasses.replace(own, scale=scale)
    leaves = (arrays[n] for n in ("mean", "covariance", "noise", "colour"))
    return FleetPrior(
        network,
        own,
        Population(*map(jnp.asarray, leaves)),
        tuple(map(str, header["donors"])),
        arrays["estimate"],
        arrays["distance"],
        arrays["freedom"],
        arrays["used"].astype(bool),
        tuple(map(str, header["remark"])),
        tuple(int(n) for n in header["rungs"]),
        arrays["ladder"],
        arrays["left"],
        arrays["output_spread"],
        tuple(int(n) for n in header["counts"]),
        arrays["by_count"],
        arrays["alone"],
        arrays["expected_before"],
        arrays["slope"],
        arrays["typical"],
        bool(header["linear"]),
        int(header["warm_up"]),
        gates,
        feedback,
    )
