"""The next command: what the verdict calls for, never what is in use already."""

import dataclasses
import shlex

import pytest

from jaxnarx.evaluation.verdict import REMEDIES, Reason, Verdict
from jaxnarx.settings import Identification, Polynomial
from jaxnarx.shell.commands import Identify
from jaxnarx.shell.commands.flags import words_of
from jaxnarx.shell.commands.parse import parse
from jaxnarx.shell.commands.search import Automatic
from jaxnarx.shell.next_command import propose_after_method, propose_after_search

TYPED = [
    '--output NOx --terms 9 --schedule "speed[t]" --models 4 --force',
    "--log NOx HC --ridge 1e-7 --input-lags --filters 1 2.5",
    "--schedule a b --partition axis-tree --steps 0",
    "--set refine=prediction pool.degree=3",
    "--set refine.tolerance=1e-5 --horizons 10 30",
]


def of(outputs):
    return Identification(pool=Polynomial(outputs=outputs))


def following(command, remedy, outputs=("NOx",)):
    found = (Reason("not usable", "why", remedy),) if remedy else ()
    text = propose_after_method(
        command,
        Verdict("", found),
        model="run/m",
        outputs=outputs,
        inputs=("speed", "load", "air"),
        sample_time=0.1,
    )
    return parts(text)


def parts(text):
    """The words of a command, and the remark behind it."""
    command, remark, rest = text.partition("  (")
    return shlex.split(command), remark + rest


@pytest.mark.parametrize("options", TYPED)
def test_words_make_the_command_again(options):
    command = parse(["identify", "a.toml", *shlex.split(options)])
    assert isinstance(command, Identify)
    assert parse(words_of(command)[1:]) == command


def test_a_good_model_is_simulated():
    words, _ = following(Identify("a.toml"), "")
    assert words == ["jaxnarx", "simulate", "run/m", "new_run.csv"]


@pytest.mark.parametrize("remedy", REMEDIES)
@pytest.mark.parametrize("outputs", [("NOx",), ("NOx", "CO")])
def test_every_remedy_ends_and_changes_something(remedy, outputs):
    """Followed again and again, each command parses and differs from the last."""
    command = dataclasses.replace(Identify("a.toml", of(outputs)), out="x", force=True)
    for _ in range(6):
        words, then = following(command, remedy, outputs)
        new = parse(words[1:])
        assert isinstance(new, Identify) and new.out is None and not new.force
        assert then or new != dataclasses.replace(command, out=None, force=False)
        command = new


def test_what_cannot_diverge_is_proposed_in_the_end():
    command = Identify("a.toml", of(("NOx",)))
    for _ in range(3):
        command = parse(following(command, "bounded")[0][1:])
        assert isinstance(command, Identify)
    assert isinstance(command.method, Identification)
    pool = command.method.pool
    assert pool.output_lags == () and pool.filters == (0.4, 1.6, 6.4)


def test_a_search_with_an_unstable_region_is_proposed_with_the_stable_preset():
    asked = Automatic()
    command = Identify("a.toml", asked)
    found = Verdict("", (Reason("usable with limits", "why", "unstable"),))
    text = propose_after_search(command, asked, found, model="run/m")
    assert text.endswith("--preset ecu")
    asked = Automatic(preset="ecu")
    text = propose_after_search(Identify("a.toml", asked), asked, found, model="run/m")
    assert "more training records" in text
