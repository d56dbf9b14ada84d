"""Registries of what other packages add, by name: one for every kind.

Each kind has its registry in the room it belongs to: `jaxnarx.models.VALIDITIES`,
`jaxnarx.settings.SELECTORS` and `PARTITIONS`, `jaxnarx.identification.CANDIDATES`,
`jaxnarx.evaluation.ANALYSES`,
`jaxnarx.engines.BEDS`, `jaxnarx.data.readers.KINDS` and `jaxnarx.exporters.TARGETS`. A
package names the module that fills them as an entry point:

    [project.entry-points."jaxnarx.extensions"]
    my_package = "my_package.jaxnarx_extension"

Such modules are imported when a name is looked up that is not known otherwise, never by
importing jaxnarx, and whatever file the name stands in: only what is installed is
loaded, nothing that a model or data file names.
"""

import dataclasses
import functools
import importlib.metadata
import types
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import Any, Generic, TypeVar

from jaxnarx.errors import SpecError, suggest

ENTRY_POINT_GROUP = "jaxnarx.extensions"
"""The entry points of packages that add something."""

T = TypeVar("T")


class Registry(MutableMapping[str, T], Generic[T]):
    """Things of one kind by name: the package's own, and those that are registered."""

    def __init__(
        self,
        what: str,
        own: Mapping[str, T],
        *,
        check: Callable[[str, T], None] | None = None,
    ):
        """`what` is one of them in words; `check` raises SpecError for a wrong one."""
        self.what, self._check = what, check
        self._items, self._own = dict(own), frozenset(own)
        self._examples: dict[str, Callable[..., Any]] = {}

    def register(
        self, name: str, value: T, *, example: Callable[..., Any] | None = None
    ) -> T:
        """Add one; `example` makes what its contract is tried with.

        The same may be registered anew, as when a notebook cell runs twice; a name that
        another has is a SpecError.
        """
        there = self._items.get(name, value)
        if name in self._own or _home(there) != _home(value):
            raise SpecError(
                f"{self.what} of another kind is called {name!r} already "
                f"({'.'.join(_home(there)[:2])}); give yours another name",
                field="name",
            )
        if self._check is not None:
            self._check(name, value)
        self._items[name] = value
        if example is not None:
            self._examples[name] = example
        return value

    def find(self, name: str, field: str) -> T:
        """The one of that name; SpecError with the nearest ones where there is none."""
        if name not in self:
            known = list(self)
            told = suggest(name, known) if known else "None is registered."
            raise SpecError(f"there is no {self.what} {name!r}. {told}", field=field)
        return self[name]

    def example(self, name: str) -> Callable[..., Any] | None:
        """The function that makes the example of a registered one, if it has one."""
        return self._examples.get(name)

    @property
    def added(self) -> dict[str, T]:
        """The entries that packages and programs have registered; loads the
        packages."""
        load_packages()
        return {n: v for n, v in self._items.items() if n not in self._own}

    def __getitem__(self, name: str) -> T:
        if name not in self._items:
            load_packages()
        return self._items[name]

    def __setitem__(self, name: str, value: T) -> None:
        self.register(name, value)

    def __delitem__(self, name: str) -> None:
        del self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._items))

    def __len__(self) -> int:
        return len(self._items)


@functools.cache
def load_packages() -> None:
    """Import what installed packages name as their extensions, once.

    One that cannot be imported is a SpecError that names it, at every look-up that
    needs it: what it would have added is missing.
    """
    for point in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP):
        try:
            point.load()
        except Exception as error:
            raise SpecError(
                f"the extension {point.name!r} ({point.value}) cannot be loaded: "
                f"{type(error).__name__}: {error}. Mend or uninstall its package.",
                field=point.name,
            ) from error


def _home(value: Any) -> tuple[str, ...]:
    """The module and name of a class, function or module; of a value, its class and
    parts."""
    if isinstance(value, types.ModuleType):
        return (value.__name__,)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [_home(getattr(value, f.name)) for f in dataclasses.fields(value)]
        return (*_home(type(value)), *(name for part in parts for name in part))
    named = value if hasattr(value, "__qualname__") else type(value)
    return named.__module__, named.__qualname__
