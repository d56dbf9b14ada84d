"""The next command after an identification: the one that the verdict calls for."""

import dataclasses
from collections.abc import Sequence

from jaxnarx.evaluation import Verdict
from jaxnarx.shell.commands import Identify

SLOW = (4, 16, 64)
"""Time constants of filters that are proposed, in samples."""
ADVICE = {
    "cover": "  (with records that reach as far under train)",
    "test": "  (with records under test that take part in no choice)",
    "records": "  (with the record corrected or left out)",
}
"""What has to change in the description before the same command helps."""


def next_words(
    command: Identify,
    verdict: Verdict,
    *,
    model: str,
    outputs: Sequence[str],
    inputs: Sequence[str],
    sample_time: float,
) -> tuple[list[str], str]:
    """The words to type next, and a remark behind them.

    A good model is simulated. Otherwise the same identification is proposed with what
    helps against the worst reason: other records, or the first setting of a list that
    is not in use yet.
    """
    if not verdict.findings:
        return ["jaxnarx", "simulate", model, "new_run.csv"], ""
    again = dataclasses.replace(command, out=None, force=False)
    if verdict.remedy in ADVICE:
        return words_of(again), ADVICE[verdict.remedy]
    filters = tuple(float(f"{n * sample_time:.3g}") for n in SLOW)
    linear = {"degree": 1} if command.degree > 1 else {}
    choice = {"select": "simulation", "constant": "first"}
    choice = {} if len(outputs) > 1 or command.select == "simulation" else choice
    memory = {} if command.filters else {"filters": filters}
    safe = {"filters": command.filters or filters, "output_lags": ()}
    safe = safe if command.output_lags else {}
    regions = {"models": 2 * command.models}
    if command.models == 1:
        regions = {"models": 6, "schedule": tuple(f"{n}[t]" for n in inputs[:2])}
    fewer = {"terms": max(command.terms // 2, 2)} if command.terms > 2 else {}
    orders = {
        "bounded": (choice, linear, safe),
        "linear": (linear, choice, memory),
        "richer": (choice, memory, regions),
        "simpler": (fewer, linear),
    }
    change = next((c for c in orders[verdict.remedy] if c), None)
    if change is None:
        return words_of(again), "  (with more training records)"
    return words_of(dataclasses.replace(again, **change)), ""


def words_of(command: Identify) -> list[str]:
    """The command as it is typed: its description, and what differs from defaults."""
    words = ["jaxnarx", "identify", command.description]
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        if field.default is dataclasses.MISSING or value == field.default:
            continue
        words.append("--" + field.name.replace("_", "-"))
        if not isinstance(value, bool):
            listed = value if isinstance(value, tuple) else (value,)
            words += [f"{v:g}" if isinstance(v, float) else str(v) for v in listed]
    return words
