"""An importer of FMUs for tests, the same for both versions, around fmpy's calls.

fmpy is a test dependency only, and another's reading of the standard.
"""

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.model_description import read_model_description

REFUSED = FMICallException
"""What fmpy raises where a call returns an error."""


class Importer:
    """One instance of the FMU in a folder; `events`: in event mode (FMI 3.0)."""

    def __init__(self, place: Path, *, events: bool = False, guid: str | None = None):
        self.about: Any = read_model_description(str(place))
        self.at = {v.name: v.valueReference for v in self.about.modelVariables}
        self.version = int(self.about.fmiVersion[0])
        kind = fmi2.FMU2Slave if self.version == 2 else fmi3.FMU3Slave
        # which of fmpy's two classes is known to the version only
        self.own: Any = kind(
            guid=guid or self.about.guid or self.about.instantiationToken,
            unzipDirectory=str(place),
            modelIdentifier=self.about.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.events = events
        self.own.instantiate(**({"eventModeUsed": True} if events else {}))

    def enter(self, time: float = 0.0, stop: float | None = None) -> None:
        """To initialization mode."""
        if self.version == 2:
            self.own.setupExperiment(startTime=time, stopTime=stop)
            self.own.enterInitializationMode()
        else:
            self.own.enterInitializationMode(startTime=time, stopTime=stop)

    def leave(self) -> None:
        """Initialization mode; on to step mode."""
        self.own.exitInitializationMode()
        if self.events:
            self.update()

    def update(self) -> None:
        """What event mode has to do, back to step mode."""
        assert not any(self.own.updateDiscreteStates()[:4])
        self.own.enterStepMode()

    def set(self, names: Sequence[str], values: Sequence[float]) -> None:
        """Real variables."""
        references = [self.at[n] for n in names]
        call = self.own.setReal if self.version == 2 else self.own.setFloat64
        call(references, list(map(float, values)))

    def get(self, *names: str) -> list[float]:
        """Real variables."""
        call = self.own.getReal if self.version == 2 else self.own.getFloat64
        return list(call([self.at[n] for n in names]))

    def truth(self, *names: str) -> list[bool]:
        """Boolean variables."""
        return list(map(bool, self.own.getBoolean([self.at[n] for n in names])))

    def start(self, kind: int) -> None:
        """The parameter `start`."""
        call = self.own.setInteger if self.version == 2 else self.own.setInt64
        call([self.at["start"]], [kind])

    def step(self, time: float, size: float) -> None:
        """doStep; an event is wanted behind it where there is event mode."""
        found = self.own.doStep(
            currentCommunicationPoint=time, communicationStepSize=size
        )
        if self.version == 3:
            assert found[:3] == (self.events, False, False)

    def given(self, inputs, outputs, names: Sequence[str]) -> None:
        """History, the oldest first, as start values: columns in the order of names."""
        self.start(2)
        rows = np.concatenate([inputs, outputs], axis=1)[::-1]
        lags = [f"given.{n}[{k + 1}]" for n in names for k in range(len(rows))]
        self.set(lags, rows.T.ravel().tolist())

    def end(self) -> None:
        """Its memory is given back."""
        self.own.freeInstance()


def unpacked(content: bytes | str, place: Path) -> Path:
    """An FMU in a folder."""
    assert isinstance(content, bytes)
    place.mkdir(parents=True)
    archive = place.with_suffix(".fmu")
    archive.write_bytes(content)
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(place)
    return place
