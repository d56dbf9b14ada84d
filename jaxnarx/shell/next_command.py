"""The next command: how it is printed, and which one a verdict calls for."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from jaxnarx.settings import (
    KIND_KEY,
    Global,
    Lolimot,
    SigmoidTree,
    SimulationOLS,
    replace_at,
)
from jaxnarx.shell.commands import Identify
from jaxnarx.shell.commands.flags import words_of
from jaxnarx.shell.commands.search import Automatic
from jaxnarx.shell.messages import quote_command, say

if TYPE_CHECKING:
    from jaxnarx.evaluation import Verdict

FILTER_TIME_CONSTANTS_SAMPLES = (4, 16, 64)
"""Time constants of filters that are proposed, in samples."""
DESCRIPTION_REMARKS = {
    "cover": "  (with records that reach as far under train)",
    "test": "  (with records under test that take part in no choice)",
    "records": "  (with the record corrected or left out)",
    "intervals": "  (with more groups of records under train)",
}
"""What has to change in the description before the same command helps."""


LARGER_PRESETS = {"quick": "good", "linear": "good", "ecu": "good", "good": "best"}
"""The preset that tries more."""


def tell_next(command: str) -> None:
    """Print the command to type next, as `quote_command` makes it."""
    say(f"\nNext: {command}")


def propose_simulation(model: str) -> str:
    """The command that runs a model on new records."""
    return quote_command("jaxnarx", "simulate", model, "new_run.csv")


def propose_after_search(
    command: Identify, asked: Automatic, verdict: "Verdict | None", *, model: str
) -> str:
    """The command to type next after a search, and a remark behind it.

    A good model is simulated; an interrupted search (no verdict) is gone on with. Else
    the search is proposed again, with other records or a larger preset.
    """
    if verdict is not None and not verdict.findings:
        return propose_simulation(model)
    again = dataclasses.replace(command, force=False)
    if verdict is None:
        return _propose(again, "  (goes on)")
    if verdict.remedy == "test":
        return _propose(again, DESCRIPTION_REMARKS["test"])
    # With other records it is another search.
    anew = dataclasses.replace(again, force=True)
    if verdict.remedy in DESCRIPTION_REMARKS:
        return _propose(anew, DESCRIPTION_REMARKS[verdict.remedy])
    again = dataclasses.replace(again, out=None)
    if verdict.remedy == "bounded" and asked.preset != "linear":
        change = dataclasses.replace(asked, preset="linear")
    elif verdict.remedy == "unstable" and asked.preset != "ecu":
        change = dataclasses.replace(asked, preset="ecu")
    elif asked.preset in LARGER_PRESETS and verdict.remedy not in (
        "bounded",
        "unstable",
    ):
        change = dataclasses.replace(
            asked, preset=LARGER_PRESETS[asked.preset], budget=None
        )
    else:
        return _propose(anew, "  (with more training records)")
    return _propose(dataclasses.replace(again, method=change))


def propose_after_method(
    command: Identify,
    verdict: "Verdict",
    *,
    model: str,
    outputs: Sequence[str],
    inputs: Sequence[str],
    sample_time: float,
) -> str:
    """The command to type next after one method, and a remark behind it.

    A good model is simulated. Otherwise the same identification is proposed with what
    helps against the worst reason: other records, or the first setting of a list that
    is not in use yet.
    """
    if not verdict.findings:
        return propose_simulation(model)
    again = dataclasses.replace(command, out=None, force=False)
    if verdict.remedy in DESCRIPTION_REMARKS:
        return _propose(again, DESCRIPTION_REMARKS[verdict.remedy])
    method = command.method
    assert not isinstance(method, Automatic), "a search has no settings to change"
    pool, terms = method.pool, getattr(method.select, "max_terms", 2)
    filters = tuple(
        float(f"{n * sample_time:.3g}") for n in FILTER_TIME_CONSTANTS_SAMPLES
    )
    linear = {"pool.degree": 1} if pool.degree > 1 else {}
    free = isinstance(method.select, SimulationOLS)
    choice = {} if len(outputs) > 1 or free else {"select": "simulation"}
    memory = {} if pool.filters else {"pool.filters": filters}
    safe = {"pool.filters": pool.filters or filters, "pool.output_lags": ()}
    safe = safe if pool.output_lags else {}
    regions: dict[str, Any] = {}
    if isinstance(method.grow, Global):
        divided = tuple(f"{n}[t]" for n in inputs[:2])
        regions = {
            "grow": {KIND_KEY: "lolimot", "scheduling": divided, "max_models": 6}
        }
    elif isinstance(method.grow, Lolimot | SigmoidTree):
        regions = {"grow.max_models": 2 * method.grow.max_models}
    fewer = {"select.max_terms": max(terms // 2, 2)} if terms > 2 else {}
    orders: dict[str, tuple[dict[str, Any], ...]] = {
        "bounded": (choice, linear, safe),
        "unstable": (choice, linear, safe),
        "linear": (linear, choice, memory),
        "richer": (choice, memory, regions),
        "simpler": (fewer, linear),
    }
    change = next((c for c in orders[verdict.remedy] if c), None)
    if change is None:
        return _propose(again, "  (with more training records)")
    return _propose(dataclasses.replace(again, method=replace_at(method, change)))


def _propose(command: Identify, remark: str = "") -> str:
    return quote_command(*words_of(command), remark=remark)
