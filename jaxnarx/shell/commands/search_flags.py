"""Options of a search, as they are typed. No jax here."""

from typing import Annotated, Any

from tyro.conf import arg

from jaxnarx.checks import choice
from jaxnarx.docstrings import field_texts
from jaxnarx.errors import SpecError
from jaxnarx.settings import PRESETS
from jaxnarx.shell.commands.search import Automatic
from jaxnarx.shell.parse_ranges import parse_seconds

SEARCH_OPTIONS = ("preset", "budget", "candidates", "states")


def search_options() -> list[tuple[str, Any, None]]:
    """Name, annotated type and default of every option, for the parser's class."""
    texts = field_texts(Automatic)
    kinds: dict[str, tuple[Any, str | None, str]] = {
        "preset": (str, f"{{{','.join(PRESETS)}}}", f"(default: {Automatic.preset})"),
        "budget": (str, "TIME", ""),
        "candidates": (int, "INT", ""),
        "states": (int, "INT", ""),
    }
    return [
        (
            name,
            Annotated[
                kind | None,
                arg(metavar=word, help=texts[name], help_behavior_hint=hint),
            ],
            None,
        )
        for name, (kind, word, hint) in kinds.items()
    ]


def make_search(parsed: Any) -> Automatic:
    """The search that was asked for; SpecError where there is none such."""
    if parsed.hold_out is not None:
        raise SpecError(
            "--hold-out belongs to one method; a search leaves groups of records out"
        )
    budget = None if parsed.budget is None else parse_seconds(parsed.budget, "--budget")
    if parsed.candidates is not None and parsed.candidates < 1:
        raise SpecError(f"--candidates must be at least 1, got {parsed.candidates}")
    if parsed.states is not None and parsed.states < 0:
        raise SpecError(f"--states must not be negative, got {parsed.states}")
    return Automatic(
        preset=choice(parsed.preset or Automatic.preset, PRESETS, "preset"),
        budget=budget,
        candidates=parsed.candidates,
        states=parsed.states,
        outputs=tuple(parsed.output or ()),
    )


def refuse_search(parsed: Any, option: str) -> None:
    """SpecError where an option of a search comes with one of a method."""
    for name in SEARCH_OPTIONS:
        if getattr(parsed, name, None) is not None:
            raise SpecError(
                f"--{name} belongs to a search, and --{option} makes this one method: "
                "leave one of them out"
            )


def words_of_search(method: Automatic) -> list[str]:
    """The options as they are typed, those that differ from defaults."""
    words = ["--output", *method.outputs] if method.outputs else []
    for name in SEARCH_OPTIONS:
        value = getattr(method, name)
        if value != getattr(Automatic, name):
            words += [f"--{name}", f"{value:g}s" if name == "budget" else str(value)]
    return words
