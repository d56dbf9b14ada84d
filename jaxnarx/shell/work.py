"""What the commands do."""

import sys
from pathlib import Path

from jaxnarx.errors import SpecError
from jaxnarx.shell import commands
from jaxnarx.shell.progress import say


def run(command: commands.Command) -> int:
    """Run one command; returns the exit code."""
    if isinstance(command, commands.Check):
        return _check(command)
    _configure()
    if isinstance(command, commands.Demo):
        return _demo(command)
    if isinstance(command, commands.Identify):
        return _identify(command)
    if isinstance(command, commands.Simulate):
        return _simulate(command)
    return _report(command)


def _configure() -> None:
    """float64 and a compilation cache: the command line sets them, never the library."""
    import os

    import jax

    jax.config.update("jax_enable_x64", True)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    cache = Path(home) / "jaxnarx" / "compiled"
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _check(command: commands.Check) -> int:
    import json

    from jaxnarx.data import check, read_split, suggest_lags

    split = read_split(command.description, root=command.root)
    data = split.train if split.train is not None else split.all
    findings, lags = check(data), suggest_lags(data)
    if command.json:
        say(json.dumps({"findings": findings.to_dict()}, allow_nan=False, indent=1))
        return 0 if findings.is_okay else 3
    say(f"{len(data)} records, {data.samples} samples at {data.sample_time:g} s")
    say(str(findings))
    say()
    say(str(lags))
    flags = " ".join(str(d) for d in lags.input_lags)
    own = " ".join(str(d) for d in lags.output_lags)
    say(
        f"\nNext: jaxnarx identify {command.description} --output "
        f"{data.channels.output_names[0]} --input-lags {flags} --output-lags {own}"
    )
    return 0 if findings.is_okay else 3


def _demo(command: commands.Demo) -> int:
    import jax

    from jaxnarx.engines import pfi_siso_records
    from jaxnarx.methods import ForwardOLS, Lolimot, SimulationError
    from jaxnarx.shell.identify import Plan, identify
    from jaxnarx.shell.output import run_folder

    if command.events < 200:
        raise SpecError("--events must be at least 200", field="events")
    folder = run_folder(command.out, "demo", force=command.force)
    say(f"Simulating the port-injected engine: 3 records of {command.events} events")
    data = pfi_siso_records(jax.random.key(command.seed), (command.events,) * 3)
    plan = Plan(
        outputs=("speed",),
        input_lags=(2, 3, 4, 6, 8, 12, 16, 24),
        output_lags=(1, 2),
        degree=1,
        select=ForwardOLS(max_terms=10),
        grow=Lolimot(scheduling=("duty[t-3]", "speed[t-1]"), max_models=command.models),
        refine=SimulationError(),
        command=" ".join(["jaxnarx", *sys.argv[1:]]),
    )
    parts = {"train": data[0], "validate": data[1], "test": data[2]}
    identify(plan, parts, folder)
    say(f"\nNext: open {folder / 'report.html'}, or identify your own records: "
        "jaxnarx check engine.toml")
    return 0


def _identify(command: commands.Identify) -> int:
    from jaxnarx.data import hold_out, read_split
    from jaxnarx.methods import ForwardOLS, Global, Lolimot, SimulationError
    from jaxnarx.shell.identify import Plan, identify
    from jaxnarx.shell.output import run_folder

    split = read_split(command.description, root=command.root)
    train = split.train if split.train is not None else split.all
    outputs = command.output or tuple(train.channels.output_names)
    name = f"{Path(command.description).stem}-{'-'.join(outputs[:3])}"
    folder = run_folder(command.out, name, force=command.force)
    validate = split.validate
    say(f"{len(train)} records for training, {train.samples} samples at "
        f"{train.sample_time:g} s")
    if validate is None:
        train, validate = hold_out(train, share=command.hold_out)
        say("Held out for validation: " + ", ".join(validate.names))
    if command.models > 1 and not command.schedule:
        raise SpecError(
            "--models above 1 needs scheduling variables, such as --schedule "
            f"'{train.channels.input_names[0]}[t]'",
            field="schedule",
        )
    growth = Global()
    if command.models > 1:
        growth = Lolimot(
            scheduling=command.schedule,
            max_models=command.models,
            k_sigma=command.k_sigma,
        )
    plan = Plan(
        outputs=outputs,
        input_lags=command.input_lags,
        output_lags=command.output_lags,
        degree=command.degree,
        select=ForwardOLS(max_terms=command.terms, constant=command.constant),
        grow=growth,
        refine=SimulationError(
            horizons=command.horizons,
            max_steps=command.steps,
            window_steps=command.window_steps if command.steps else 0,
            ridge=command.ridge,
        ),
        command=" ".join(["jaxnarx", *sys.argv[1:]]),
    )
    parts = {"train": train, "validate": validate}
    if split.test is not None:
        parts["test"] = split.test
    result = identify(plan, parts, folder)
    say(f"\nNext: open {folder / 'report.html'}, or run the model on new files: "
        f"jaxnarx simulate {folder / 'model.safetensors'} FILE.csv")
    return _verdict(result, command.require_fit)


def _verdict(report, required: float | None) -> int:
    if required is None:
        return 0
    status = 0
    for channel in report.outputs:
        row = report.pooled(channel.name)
        if row is None or row.fit is None or row.fit < required:
            got = "no figure (diverged)" if row is None or row.fit is None else (
                f"{row.fit:.1f} %"
            )
            print(
                f"jaxnarx: the free-run fit of {channel.name} on {report.main} is {got}, "
                f"below the required {required:g} %",
                file=sys.stderr,
            )
            status = 1
    return status


def _simulate(command: commands.Simulate) -> int:
    from jaxnarx.data import Dataset, read, read_files
    from jaxnarx.models import load
    from jaxnarx.shell.output import write_trajectories
    from jaxnarx.simulation import predict, simulate

    if not command.files:
        raise SpecError("give data files or one TOML description", field="files")
    network = load(command.model)
    if command.files[0].endswith(".toml"):
        if len(command.files) > 1:
            raise SpecError("give one description, or data files", field="files")
        data: Dataset = read(command.files[0], root=command.root)
    else:
        data = read_files(
            command.files, network.channels, sample_time=float(network.sample_time)
        )
    if command.steps is None:
        solution = simulate(network, data)
    else:
        solution = predict(network, data, command.steps)
    paths = write_trajectories(solution.value, data, command.out, force=command.force)
    for path in paths:
        say(f"wrote {path}")
    if solution.detail:
        print(f"jaxnarx: {solution.status_name}: {solution.detail}", file=sys.stderr)
    say(f"\nNext: jaxnarx report {command.model} DESCRIPTION.toml")
    return 0


def _report(command: commands.Report) -> int:
    from jaxnarx.data import read_split
    from jaxnarx.evaluation import report
    from jaxnarx.models import load
    from jaxnarx.shell.output import run_folder, write_report

    network = load(command.model)
    split = read_split(command.description, root=command.root)
    named = {"train": split.train, "validate": split.validate, "test": split.test}
    parts = {k: v for k, v in named.items() if v is not None} or {"data": split.all}
    result = report(
        network, parts, provenance={"command": " ".join(["jaxnarx", *sys.argv[1:]])}
    )
    say(str(result))
    if command.out is not None:
        folder = run_folder(command.out, "report", force=command.force, mark="report.json")
        write_report(result, folder)
        say(f"\nNext: open {folder / 'report.html'}")
    return _verdict(result, command.require_fit)

