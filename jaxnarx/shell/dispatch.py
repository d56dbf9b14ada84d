"""What the commands do."""

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxnarx.errors import SpecError
from jaxnarx.files import cache_folder
from jaxnarx.shell import commands
from jaxnarx.shell.description import read_description
from jaxnarx.shell.exit_code import exit_code_of, require_finite
from jaxnarx.shell.messages import about, quote_command, say, size, warn
from jaxnarx.shell.next_command import (
    propose_after_method,
    propose_simulation,
    tell_next,
)
from jaxnarx.shell.reading import tell_reading

if TYPE_CHECKING:
    from jaxnarx.data import Dataset, LagSuggestion, Split
    from jaxnarx.settings import Identification


def run(command: commands.Command, *, typed: str) -> int:
    """Run one command; returns the exit code. `typed` is what the user wrote."""
    with tell_reading():
        return _run(command, typed)


def _run(command: commands.Command, typed: str) -> int:
    if isinstance(command, commands.Check):
        return _check(command)
    if isinstance(command, commands.Describe):
        from jaxnarx.shell.describe import describe

        return describe(command)
    if isinstance(command, commands.Prepare):
        return _prepare(command)
    _configure()
    if isinstance(command, commands.Demo):
        return _demo(command, typed)
    if isinstance(command, commands.SimulateEngine):
        return _simulate_engine(command, typed)
    if isinstance(command, commands.Identify):
        return _identify(command, typed)
    if isinstance(command, commands.Leaderboard):
        return _leaderboard(command)
    if isinstance(command, commands.Choose):
        return _choose(command, typed)
    if isinstance(command, commands.Invert):
        return _invert(command, typed)
    if isinstance(command, commands.Export):
        return _export(command, typed)
    if isinstance(command, commands.ImportDcm):
        return _import_dcm(command)
    if isinstance(command, commands.Plan):
        return _plan(command, typed)
    if isinstance(command, commands.Adapt):
        return _adapt(command)
    if isinstance(command, commands.Calibrate):
        return _calibrate(command, typed)
    if isinstance(command, commands.Control):
        return _control(command, typed)
    if isinstance(command, commands.Sweep):
        return _sweep(command)
    if isinstance(command, commands.Simulate):
        return _simulate(command)
    if isinstance(command, commands.FleetCommand):
        return _fleet(command)
    return _report(command, typed)


def _configure() -> None:
    """float64 and a compilation cache: set here, never by the library.

    Who names a cache by JAX_COMPILATION_CACHE_DIR gets that one. A program in it that a
    killed process has half written is compiled anew, and nobody need hear of it.
    """
    import warnings

    import jax

    warnings.filterwarnings("ignore", "Error reading persistent compilation cache")
    jax.config.update("jax_enable_x64", True)
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        # Small programs are many: together they take longer than the large ones.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    cache = cache_folder("compiled")
    if cache is not None:
        jax.config.update("jax_compilation_cache_dir", str(cache))


def _check(command: commands.Check) -> int:
    import json

    from jaxnarx.data import check, suggest_lags

    split = read_description(command.description, command.root)
    if command.model is not None:
        return _check_against(command.model, split.all, json=command.json)
    data = split.train if split.train is not None else split.all
    findings, lags = check(data), suggest_lags(data)
    status = 0 if findings.is_okay else 3
    if command.json:
        found = {"findings": findings.to_dict(), "lags": _lags_dict(lags)}
        say(json.dumps(found, allow_nan=False, indent=1))
        return status
    which = "" if split.train is None else " for training"
    say(f"{size(data)}{which}")
    say(f"{findings}\n\n{lags}")
    root = () if command.root is None else ("--root", command.root)
    if status:
        words = ["jaxnarx", "check", command.description, *root]
        tell_next(quote_command(*words, remark=", errors corrected"))
        return status
    names = data.channels.output_names
    one = ("--output", names[0]) if len(names) > 1 else ()
    tell_next(quote_command("jaxnarx", "identify", command.description, *root, *one))
    return status


def _check_against(model: str, data: "Dataset", *, json: bool) -> int:
    """Tell how far all records leave the domain of a model."""
    _configure()
    import dataclasses
    from json import dumps

    from jaxnarx.confidence import domain
    from jaxnarx.data import match_channels
    from jaxnarx.models import load

    network = load(model)
    known = match_channels(data, network.channels.measured)[0]
    with about(model):
        found = domain(network, known).value
    if json:
        told = [dataclasses.asdict(one) for one in found.excursions]
        say(dumps({"outside": found.outside, "excursions": told}, indent=1))
        return 0
    say(f"{size(known)}\n{found}")
    return 0


def _prepare(command: commands.Prepare) -> int:
    from jaxnarx.shell.prepare import make_steps, write_prepared

    steps = make_steps(command)
    split = read_description(command.description, command.root)
    _tell_next_check(write_prepared(split, steps, command.out, force=command.force))
    return 0


def _simulate_engine(command: commands.SimulateEngine, typed: str) -> int:
    from jaxnarx.shell.simulate_engine import simulate_engine

    _tell_next_check(simulate_engine(command, typed))
    return 0


def _tell_next_check(file: Path) -> None:
    """Advise to look at a description that was just written."""
    # the variable would send the reader of the new files to the old ones
    elsewhere = os.environ.get("JAXNARX_DATA")
    root = ("--root", str(file.parent)) if elsewhere else ()
    tell_next(quote_command("jaxnarx", "check", str(file), *root))


def _lags_dict(lags: "LagSuggestion") -> dict[str, Any]:
    pairs = [
        {
            "input": u,
            "output": y,
            "dead_time": lags.dead_time[u, y],
            "settling": lags.settling[u, y],
        }
        for u, y in lags.dead_time
    ]
    return {
        "input_lags": list(lags.input_lags),
        "output_lags": list(lags.output_lags),
        "filters": list(lags.filters),
        "unit": "samples",
        "sample_time": lags.sample_time,
        "pairs": pairs,
    }


def _demo(command: commands.Demo, typed: str) -> int:
    import jax

    from jaxnarx.engines import pfi_siso_records
    from jaxnarx.settings import ForwardOLS, Identification, Lolimot, Polynomial
    from jaxnarx.shell.identify import OneMethod, identify
    from jaxnarx.shell.output import RUN_FILES, run_folder

    if command.events < 200:
        raise SpecError("--events must be at least 200", field="events")
    method = Identification(
        pool=Polynomial(
            outputs=("speed",),
            input_lags=(2, 3, 4, 6, 8, 12, 16, 24),
            output_lags=(1, 2),
            degree=1,
        ),
        select=ForwardOLS(max_terms=10),
        grow=Lolimot(scheduling=("duty[t-3]", "speed[t-1]"), max_models=command.models),
    )
    task = OneMethod(method, typed)
    with run_folder(
        command.out, "demo", force=command.force, marks=RUN_FILES
    ) as folder:
        say(
            f"Simulating the port-injected engine: 3 records of {command.events} events"
        )
        data = pfi_siso_records(jax.random.key(command.seed), (command.events,) * 3)
        parts = {"train": data[0], "validate": data[1], "test": data[2]}
        words = ("jaxnarx", "check", "engine.toml")
        then = quote_command(*words, remark="  (a description of your records)")
        result = identify(task, parts, folder, follow=lambda _: then)
    return exit_code_of(result)


def _leaderboard(command: commands.Leaderboard) -> int:
    from jaxnarx.shell.search.choose import show

    return show(command)


def _choose(command: commands.Choose, typed: str) -> int:
    from jaxnarx.shell.search.choose import choose

    return choose(command, typed)


def _identify(command: commands.Identify, typed: str) -> int:
    if isinstance(command.method, commands.Automatic):
        from jaxnarx.shell.search.run import search

        return search(command, command.method, typed)
    return _identify_by_method(command, command.method, typed)


def _identify_by_method(
    command: commands.Identify, asked: "Identification", typed: str
) -> int:
    from jaxnarx.shell.identify import (
        OneMethod,
        check_method,
        identify,
        preparation_task,
    )
    from jaxnarx.shell.output import RUN_FILES, run_folder

    require_finite("require_fit", command.require_fit)
    share = 0.2 if command.hold_out is None else command.hold_out
    _require_share(share)
    split = read_description(command.description, command.root)
    method = check_method(asked, split.all.channels)
    if split.physics:
        warn("[physics] belongs to a search: this one method does not keep to it")
    if split.at_rest is not None:
        warn("at_rest belongs to a search: this one method is trained on records alone")
    task = preparation_task(split.preparation, OneMethod(method, typed))
    outputs = method.pool.outputs
    name = f"{Path(command.description).stem}-{'-'.join(outputs[:3])}"
    with run_folder(command.out, name, force=command.force, marks=RUN_FILES) as folder:
        parts = _parts(split, share)
        follow = partial(
            propose_after_method,
            command,
            model=str(folder / "model.safetensors"),
            outputs=outputs,
            inputs=parts["train"].channels.input_names,
            sample_time=parts["train"].sample_time,
        )
        result = identify(task, parts, folder, follow=follow)
    return exit_code_of(result, command.require_fit)


def _parts(split: "Split", share: float) -> "dict[str, Dataset]":
    from jaxnarx.data import hold_out

    train = split.train if split.train is not None else split.all
    validate = split.validate
    say(f"{size(train)} for training")
    if validate is None:
        train, validate = hold_out(train, share=share)
        say("Held out for validation: " + ", ".join(validate.names))
    parts = {"train": train, "validate": validate}
    return parts if split.test is None else parts | {"test": split.test}


def _require_share(hold_out: float) -> None:
    if not 0 < hold_out < 1:
        raise SpecError(f"--hold-out must lie between 0 and 1, got {hold_out}")


def _simulate(command: commands.Simulate) -> int:
    from jaxnarx.shell.simulate_files import follow, simulate_files

    if command.through is None:
        return simulate_files(command)
    return follow(command, command.through)


def _export(command: commands.Export, typed: str) -> int:
    from jaxnarx.shell.export import export_model

    return export_model(command, typed)


def _import_dcm(command: commands.ImportDcm) -> int:
    from jaxnarx.shell.import_dcm import import_dcm

    return import_dcm(command)


def _adapt(command: commands.Adapt) -> int:
    from jaxnarx.shell.adapt import adapt_model

    return adapt_model(command)


def _plan(command: commands.Plan, typed: str) -> int:
    from jaxnarx.shell.plan import plan_test

    return plan_test(command, typed)


def _invert(command: commands.Invert, typed: str) -> int:
    from jaxnarx.models import load
    from jaxnarx.shell.invert import RESULT_FILES, check_command, invert, limits_of
    from jaxnarx.shell.output import run_folder

    forward = load(command.model)
    check_command(command, forward)
    limits_of(command.range, command.rate)
    split = read_description(command.description, command.root)
    name = f"{Path(command.description).stem}-inverse"
    with run_folder(
        command.out, name, force=command.force, marks=RESULT_FILES
    ) as folder:
        with about(command.description):
            parts = _parts(split, command.hold_out)
            solution = invert(command, typed, forward, parts, folder)
    say(f"\nwrote {', '.join(RESULT_FILES)} to {folder}")
    if not solution.is_okay:
        warn(
            f"{solution.status_name}: {solution.detail}. Try fewer --terms, a lower "
            "--degree or other lags."
        )
    model = str(folder / RESULT_FILES[0])
    words = ["jaxnarx", "simulate", model, "wanted.csv", "--through", command.model]
    tell_next(quote_command(*words))
    return 0


def _calibrate(command: commands.Calibrate, typed: str) -> int:
    from jaxnarx.shell.calibrate import calibrate_maps

    return calibrate_maps(command, typed)


def _control(command: commands.Control, typed: str) -> int:
    from jaxnarx.shell.control import control_engine

    return control_engine(command, typed)


def _sweep(command: commands.Sweep) -> int:
    from jaxnarx.shell.sweep.run import sweep

    sweep(command)
    return 0


def _fleet(command: commands.FleetCommand) -> int:
    from jaxnarx.shell import fleet

    if isinstance(command, commands.FleetLearn):
        return fleet.fleet_learn(command)
    if isinstance(command, commands.FleetCalibrate):
        return fleet.fleet_calibrate(command)
    if isinstance(command, commands.FleetCompare):
        return fleet.fleet_compare(command)
    return fleet.fleet_report(command)


def _report(command: commands.Report, typed: str) -> int:
    from contextlib import ExitStack
    from dataclasses import replace

    from jaxnarx.evaluation import report
    from jaxnarx.shell.identify import require_rows
    from jaxnarx.shell.junit import junit_file, write_junit
    from jaxnarx.shell.model_file import load_model
    from jaxnarx.shell.output import RUN_FILES, run_folder, write_report, write_together

    require_finite("require_fit", command.require_fit)
    bare = command.no_limits
    network = load_model(command.model, no_limits=bare, outside=command.outside)
    split = read_description(command.description, command.root)
    named = {"train": split.train, "validate": split.validate, "test": split.test}
    parts = {k: v for k, v in named.items() if v is not None} or {"data": split.all}
    require_rows(parts, network.history)
    with ExitStack() as stack:
        folder, force = None, command.force
        if command.out is not None:
            folder = stack.enter_context(
                run_folder(command.out, "", force=force, marks=RUN_FILES[1:])
            )
        junit = stack.enter_context(junit_file(command.junit, force=force))
        with about(command.description, but=("over",)):
            told = {"command": typed}
            if split.preparation is not None:
                told["preparation"] = split.preparation.describe()
            others = {
                path: load_model(path, no_limits=bare) for path in command.compare
            }
            over = command.map or None
            result = report(
                network,
                parts,
                beside=others,
                over=over,
                within=command.within,
                physics=split.physics,
                provenance=told,
            )
            result = replace(result, next_command=propose_simulation(command.model))
        say(str(result))
        if folder is not None:
            with write_together(folder) as place:
                write_report(result, place)
        if junit is not None:
            write_junit(result, junit, command.require_fit)
    if folder is not None:
        say(f"\nOpen {folder / 'report.html'}")
        tell_next(result.next_command)
    else:
        words = ["jaxnarx", "report", command.model, command.description]
        words += [] if command.root is None else ["--root", command.root]
        words += ["--no-limits"] if bare else []
        words += ["--out", "FOLDER"]
        tell_next(quote_command(*words, remark="  (writes the page with figures)"))
    return exit_code_of(result, command.require_fit)
