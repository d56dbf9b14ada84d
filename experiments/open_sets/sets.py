"""The open sets: training records, test records by the official split, what is scored.

Every test record carries measured samples in front (`FRONT` where the file has them)
that begin a run and are not scored; from the first scored sample on the run is free.
The splits are those of the official loader of nonlinearbenchmark.org (February 2025),
of SysIdentPy's documentation for the Bouc-Wen damper, and halves for the stirred tank.

Only the standard library is imported here; the rest inside the functions.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

FRONT = 50
"""Measured samples in front of the first scored one, where the file has them."""

SMALL = 400
"""Samples that a smoke run keeps of a record."""


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """Test records with one figure in the table.

    `first` is the first scored sample of every record. `truth` (time, outputs) of every
    record is what the run is held against, where that is not the measurement. `window`
    is how many measured samples before the first scored one the official loader gives
    to begin with: hidden states are estimated from these.
    """

    data: Any
    first: int
    truth: tuple[Any, ...] | None = None
    window: int = FRONT

    @property
    def targets(self) -> tuple[Any, ...]:
        """What the runs are held against, (time, outputs) of every record."""
        return self.truth or tuple(record.y for record in self.data)


@dataclasses.dataclass(frozen=True, eq=False)
class OpenSet:
    """Training records and the parts of the test, the first of which decides.

    `scale` turns the unit of an output's RMSE into the `unit` in which it is published.
    """

    name: str
    train: Any
    parts: Mapping[str, Part]
    unit: Mapping[str, str]
    split: str
    published: str
    scale: float = 1.0

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs, each with a row in the table."""
        return list(self.train.channels.output_names)


Pieces = Sequence[tuple[Any, Any]]
"""Inputs and outputs of every record."""


@dataclasses.dataclass(frozen=True)
class Channels:
    """Names of the columns and the sample time [s]."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_time: float
    units: Mapping[str, str]

    def dataset(self, pieces: Pieces, names: Sequence[str]) -> Any:
        """The records as a `Dataset`."""
        from jaxnarx import Dataset

        return Dataset.from_arrays(
            [u for u, _ in pieces],
            [y for _, y in pieces],
            inputs=self.inputs,
            outputs=self.outputs,
            sample_time=self.sample_time,
            units=self.units,
            names=names,
        )


def columns(path: Path, skip: int, use: Sequence[int] | None = None) -> Any:
    """Columns of a text file, (time, columns)."""
    import numpy as np

    separator = "," if path.suffix == ".csv" else None
    return np.loadtxt(path, delimiter=separator, skiprows=skip, usecols=use)


def cut(u: Any, y: Any, start: int, stop: int) -> tuple[Any, Any]:
    """Rows `start` to `stop` of inputs and outputs, as (time, channels)."""
    inputs, outputs = (a[:, None] if a.ndim == 1 else a for a in (u, y))
    return inputs[start:stop], outputs[start:stop]


def tanks(folder: Path) -> OpenSet:
    """Water tanks with overflow: one estimation and one test record of 1,024 samples.

    The first 50 test samples begin the run.
    """
    path = folder / "cascaded_tanks" / "dataBenchmark.csv"
    u, u_test, y, y_test = columns(path, 1, range(4)).T
    known = Channels(("u",), ("y",), 4.0, {"u": "V", "y": "V"})
    return OpenSet(
        name="cascaded_tanks",
        train=known.dataset([cut(u, y, 0, 1024)], ["estimation"]),
        parts={
            "test": Part(known.dataset([cut(u_test, y_test, 0, 1024)], ["test"]), 50)
        },
        unit={"y": "V"},
        split="yEst trains, yVal from sample 50 on is scored",
        published="RMSE",
    )


def drives(folder: Path) -> OpenSet:
    """Coupled electric drives: 400 samples of each record train, 100 test.

    The first 10 test samples begin the run. A model of longer memory may look at the
    end of the training record before them.
    """
    from scipy.io import loadmat

    content = loadmat(folder / "ced_coupled_drives" / "DATAUNIF.MAT")
    runs = [(content[f"u{n}"].ravel(), content[f"z{n}"].ravel()) for n in (11, 12)]
    known = Channels(("u",), ("z",), 0.02, {"u": "V", "z": "ticks/s"})
    names = ["low amplitude", "high amplitude"]
    first = 400 + 10 - FRONT
    tests = [cut(*run, first, 500) for run in runs]
    parts = {"test": Part(known.dataset(tests, names), FRONT, window=10)}
    for piece, name in zip(tests, names, strict=True):
        parts[name] = Part(known.dataset([piece], [name]), FRONT, window=10)
    return OpenSet(
        name="ced_coupled_drives",
        train=known.dataset([cut(*run, 0, 400) for run in runs], names),
        parts=parts,
        unit={"z": "ticks/s"},
        split="samples 0-399 of both records train, 410-499 are scored; 'test' pools "
        "both records, published figures are those of each",
        published="RMSE",
    )


def silverbox(folder: Path) -> OpenSet:
    """An electronic Duffing oscillator: multisine, and an arrow of growing amplitude.

    The first 50 samples of every test begin the run.
    """
    path = folder / "silverbox" / "SNLS80mV.csv"
    u, y = columns(path, 1, range(2)).T
    known = Channels(("V1",), ("V2",), 1 / 610.35, {"V1": "V", "V2": "V"})
    arrow, sines = (100, 40_575), (40_650, 127_400)
    border = sines[0] + int(0.75 * (sines[1] - sines[0]))
    spans = {
        "multisine": (border, sines[1]),
        "arrow": arrow,
        "arrow without extrapolation": (arrow[0], arrow[0] + 32_000),
    }
    return OpenSet(
        name="silverbox",
        train=known.dataset([cut(u, y, sines[0], border)], ["multisine"]),
        parts={
            name: Part(known.dataset([cut(u, y, *span)], [name]), 50)
            for name, span in spans.items()
        },
        unit={"V2": "mV"},
        split="samples 40650-127399: first 75 % train, the rest is the multisine test; "
        "arrow 100-40574, without extrapolation its first 32,000",
        published="RMSE",
        scale=1000.0,
    )


def wiener_hammerstein(folder: Path) -> OpenSet:
    """A diode between two filters: 100,000 samples train, 78,800 test.

    The first 50 test samples begin the run.
    """
    path = folder / "wiener_hammerstein" / "WienerHammerBenchmark.csv"
    u, y = columns(path, 1, range(2)).T
    known = Channels(("u",), ("y",), 1 / 51_200, {"u": "V", "y": "V"})
    test = known.dataset([cut(u, y, 105_200, 184_000)], ["test"])
    return OpenSet(
        name="wiener_hammerstein",
        train=known.dataset([cut(u, y, 5_200, 105_200)], ["estimation"]),
        parts={"test": Part(test, 50)},
        unit={"y": "mV"},
        split="samples 5200-105199 train, 105250-183999 are scored",
        published="RMSE",
        scale=1000.0,
    )


def stirred_tank(folder: Path) -> OpenSet:
    """A simulated stirred-tank reactor with two outputs; no official split."""
    table = columns(folder / "daisy_cstr" / "cstr.dat", 0)
    u, y, half = table[:, 1], table[:, 2:4], len(table) // 2
    units = {"q": "l/min", "Ca": "mol/l", "T": "K"}
    known = Channels(("q",), ("Ca", "T"), 6.0, units)
    test = known.dataset([cut(u, y, half - FRONT, len(table))], ["second half"])
    return OpenSet(
        name="daisy_cstr",
        train=known.dataset([cut(u, y, 0, half)], ["first half"]),
        parts={"test": Part(test, FRONT)},
        unit={"Ca": "mol/l", "T": "K"},
        split="first half trains, second half is scored; the run begins with the "
        "training samples before it",
        published="NRMSE",
    )


def bouc_wen(folder: Path) -> OpenSet:
    """A simulated hysteretic damper, by SysIdentPy's documented split and channels."""
    import numpy as np

    file = "boucwen_histeretic_system.csv"
    _, v, _, voltage, force = columns(folder / "bouc_wen_sysidentpy" / file, 1).T
    u = np.column_stack([voltage, v, np.sign(v)])
    known = Channels(
        *(("E", "v", "sign_v"), ("f",), 0.002),
        {"E": "V", "v": "m/s", "sign_v": "-", "f": "N"},
    )
    first = 2002
    test = known.dataset([cut(u, force, first - FRONT, 3600)], ["unseen"])
    return OpenSet(
        name="bouc_wen_sysidentpy",
        train=known.dataset([cut(u, force, 400, 2000)], ["identification"]),
        parts={"test": Part(test, FRONT)},
        unit={"f": "N"},
        split="rows 400-1999 train, 2002-3599 are scored",
        published="NRMSE, which is the RRSE of SysIdentPy's documentation",
    )


READERS: dict[str, Callable[[Path], OpenSet]] = {
    "cascaded_tanks": tanks,
    "ced_coupled_drives": drives,
    "bouc_wen_sysidentpy": bouc_wen,
    "daisy_cstr": stirred_tank,
    "silverbox": silverbox,
    "wiener_hammerstein": wiener_hammerstein,
}
"""By the name of the folder in `JAXNARX_DATA`; the smaller sets first."""


def smaller(whole: OpenSet) -> OpenSet:
    """The same set with `SMALL` samples of every record, for a smoke run."""

    def short(data: Any) -> Any:
        records = [
            dataclasses.replace(r, u=r.u[:SMALL], y=r.y[:SMALL], valid=r.valid[:SMALL])
            for r in data
        ]
        return dataclasses.replace(data, records=tuple(records))

    def part(one: Part) -> Part:
        truth = None if one.truth is None else tuple(y[:SMALL] for y in one.truth)
        return dataclasses.replace(one, data=short(one.data), truth=truth)

    parts = {name: part(one) for name, one in whole.parts.items()}
    return dataclasses.replace(whole, train=short(whole.train), parts=parts)
