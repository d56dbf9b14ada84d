"""Kinds of arguments that several commands have, as the parser shows them."""

from typing import Annotated, Any, Literal

from tyro.conf import arg


def optional(metavar: str) -> Any:
    """An option whose help tells in words what happens without it."""
    return arg(metavar=metavar, help_behavior_hint="")


Description = Annotated[str, arg(metavar="DESCRIPTION")]
Model = Annotated[str, arg(metavar="MODEL")]
Run = Annotated[str, arg(metavar="RUN")]
Folder = Annotated[str | None, optional("FOLDER")]
Names = Annotated[tuple[str, ...], optional("NAME [NAME ...]")]
Needed = Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]")]
Flag = Annotated[bool, arg(help_behavior_hint="")]
Whole = Annotated[int | None, optional("INT")]
Outside = Annotated[
    Literal["flag", "hold", "linear", "nan"] | None,
    optional("{flag,hold,linear,nan}"),
]
Percent = Annotated[float | None, optional("PERCENT")]
