"""What `jaxnarx --help` says: all commands by task, on one screen. No jax here."""

TASK_COMMANDS = {
    "data": {
        "describe": "Write the description of measurement files.",
        "check": "Find what may spoil a model; suggest lags.",
        "prepare": "Filter, resample, detrend and scale records.",
        "simulate-engine": "Simulate a virtual engine and write its records.",
    },
    "identify": {
        "demo": "Identify a virtual engine; needs no files.",
        "identify": "Search for a model, or fit one method.",
        "leaderboard": "List the candidates of a search.",
        "choose": "Choose another candidate of a search.",
        "invert": "Identify the inverse: from outputs to commands.",
    },
    "judge": {
        "report": "Score a model on records and give a verdict.",
        "plan": "Plan the next test: the most informative record.",
    },
    "use": {
        "simulate": "Run a model on new files.",
        "adapt": "Let a model follow its engine over new records.",
        "calibrate": "Optimise maps of a control unit over a cycle.",
        "control": "Make a predictive controller, and its C.",
        "export": "Write C, FMU, Python, JavaScript, MATLAB, DCM or A2L.",
        "import-dcm": "Read changed parameters back into a model.",
    },
    "research": {
        "sweep": "Identify many engines under many settings.",
        "fleet": "Learn from many engines; calibrate a new one.",
    },
}
"""Every command in one line, under the task that it belongs to."""
OVERVIEW_HEAD = """\
usage: jaxnarx COMMAND [OPTIONS] | COMMAND --help, with examples | --version
Identify engines from measurements as NARX networks with regional models.
"""
OVERVIEW_FOOT = """\
Exit codes: 0 done, 1 not usable, 2 usage, 3 files, 70 defect, 130, 143 stopped."""


def overview() -> str:
    """The help of the whole program, less than 24 lines of 80 columns."""
    rows = [
        f"{task * (n == 0):9s} {command:16s} {line}"
        for task, commands in TASK_COMMANDS.items()
        for n, (command, line) in enumerate(commands.items())
    ]
    return "\n".join([OVERVIEW_HEAD, *rows, OVERVIEW_FOOT])
