"""Commands and options of version 0.2: they work, and say what to type instead."""

import shlex

import pytest

from jaxnarx.shell import dispatch
from jaxnarx.shell.cli import run
from jaxnarx.shell.commands import COMMANDS
from jaxnarx.shell.commands.flags import add_options
from jaxnarx.shell.commands.old_names import COMMAND_NAMES, OPTION_NAMES


@pytest.mark.parametrize(
    ("old", "new", "advice"),
    [
        (
            "take runs/a 7",
            "choose runs/a 7",
            "`jaxnarx choose` instead of `jaxnarx take`",
        ),
        (
            "report m.safetensors e.toml --beside other.safetensors",
            "report m.safetensors e.toml --compare other.safetensors",
            "`--compare` instead of `--beside`",
        ),
        (
            "report m.safetensors e.toml --over 'speed[t]' load",
            "report m.safetensors e.toml --map 'speed[t]' load",
            "`--map` instead of `--over`",
        ),
        (
            "export m.safetensors --to dcm --over=speed load",
            "export m.safetensors --to dcm --map=speed load",
            "`--map` instead of `--over`",
        ),
    ],
)
def test_an_old_name_does_the_same_and_says_the_new_one(
    capsys, monkeypatch, old, new, advice
):
    ran = []

    def record(command, *, typed):
        ran.append((command, typed))
        return 0

    monkeypatch.setattr(dispatch, "run", record)
    assert run(shlex.split(new)) == 0
    assert capsys.readouterr().err == ""
    assert run(shlex.split(old)) == 0
    told = f"jaxnarx: type {advice}, which works for one release more\n"
    assert capsys.readouterr() == ("", told)
    assert ran[0] == ran[1]


def test_an_old_name_is_an_option_of_its_own_command_alone(capsys):
    assert run(["simulate", "m.safetensors", "new.csv", "--over", "a"]) == 2
    assert "--over" in capsys.readouterr().err


def test_new_names_are_there_and_old_ones_are_not():
    assert set(COMMAND_NAMES.values()) <= set(COMMANDS)
    assert not set(COMMAND_NAMES) & set(COMMANDS)
    for command, names in OPTION_NAMES.items():
        fields = add_options(COMMANDS[command]).__dataclass_fields__
        assert {new.removeprefix("--") for new in names.values()} <= set(fields)
        assert not {old.removeprefix("--") for old in names} & set(fields)
