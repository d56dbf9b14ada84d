"""What every step of preparation is: settings that are fitted, values that are applied.

Settings (`Scale(kind="min-max")`) hold wishes; `fit` looks at the training data and
returns a fitted step (`Scaled`) that holds every number it needs. Where there is
nothing to look at (`LowPass`), the settings are the fitted step. Fitted steps are
frozen, compare by value and survive as JSON.
"""

import abc
import dataclasses
from typing import Any

from jaxnarx.data.dataset import Dataset
from jaxnarx.errors import SpecError


class AbstractFitted(abc.ABC):
    """A step that knows all its numbers; frozen dataclass of plain Python values.

    A channel is addressed by name, so that data with fewer channels than the training
    data can be prepared too. Samples that are not valid have no influence on others.
    """

    @abc.abstractmethod
    def apply(self, data: Dataset) -> Dataset:
        """`data` after this step."""

    @abc.abstractmethod
    def undo(self, data: Dataset) -> Dataset:
        """`data` before this step; SpecError where that cannot be found out."""

    @abc.abstractmethod
    def describe(self) -> str:
        """What the step does, in one line or more, with numbers and units."""

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON; `kind` is the name of the class."""
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {"kind": type(self).__name__} | {
            f.name: _plain(getattr(self, f.name)) for f in fields
        }


class AbstractStep(abc.ABC):
    """Settings of a step, frozen dataclass; every option by keyword."""

    @abc.abstractmethod
    def fit(self, data: Dataset) -> AbstractFitted:
        """The step with its numbers, from the valid samples of training data."""


def cannot_undo(what: str, why: str) -> SpecError:
    """The error of a step that loses something."""
    return SpecError(f"{what} cannot be undone: {why}", field="undo")


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return list(value)
    return dict(value) if hasattr(value, "items") else value
