"""The verb `export_controller`: a predictive controller as C, proven."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.control.controller import Controller, Decision
from jaxnarx.control.observer import NOT_MEASURED, UNSURE, feedback_bounds
from jaxnarx.control.planning import (
    AT_EDGE,
    DOMAIN_LINEAR,
    DOMAIN_SQUARE,
    LEAST_CURVATURE,
    LINEAR,
    ROUND_OFF,
    SOLVED,
    SQUARE,
    block_of,
    used_inputs,
)
from jaxnarx.control.quadratic_program import MOST_STEPS, NEAR_BORDER, TOLERANCE
from jaxnarx.exporters import (
    ControllerRun,
    ControlProgram,
    Exported,
    ExportError,
    FeedbackLine,
    compiler,
    control_files,
    controller_runner,
    identifiers,
    lower,
    write_files,
)
from jaxnarx.files import TemporaryFolder
from jaxnarx.models import (
    FLAG,
    HOLD,
    LEAST_DISTANCE,
    NAN,
    REST_STEPS,
    REST_TOLERANCE,
    Network,
    depth,
    driving_signals,
    largest_sizes,
    middle_inputs,
    sources,
)

AGREEMENT = 1e-6
"""Largest difference of a decision, in shares of the ranges of commands and of quarters
of those of outputs; quadratic programs are solved to a thousandth of that."""
ROUND_OFF_SHARE = 1e-12
"""Measurements of a second run of the controller are off by so many quarters of the
outputs' ranges."""
TOGETHER = 1e-7
"""Largest difference of both runs, as `AGREEMENT`; behind a larger one, round-off
decides, and nothing is compared."""
LEAST_SHARE = 0.5
"""Of the proof's samples that must be compared."""
BEYOND = 0.1
"""How far references and inputs of the proof lie beyond their ranges, as shares of
these."""
STRETCHES, SAMPLES = 8, 25
"""Of the proof, each begun anew: round-off grows in a loop that is not stable."""
OFF, NOISE, MISSING = 0.2, 0.02, 0.05
"""What the proof's plant is off by, and its noise, in quarters of the outputs' ranges,
and the share of measurements and inputs that are missing."""


@guard_arguments
def export_controller(controller: Controller, *, name: str = "model") -> Exported:
    """Export a controller as C99 that decides the same, sample by sample.

    `NAME_control_begin(&c, u, measured)` and `NAME_control_step(&c, measured,
    reference, given, &out)` are `controller.begin` and `controller.step`: observer,
    horizon with exact slopes and quadratic program in double precision, nothing
    allocated and every loop bounded by a count. The files are compiled, and run beside
    the controller, eight times for 25 samples, with random references and inputs up to
    a tenth beyond the trained ranges, and outputs that are off by a constant and have
    noise; measurements and inputs are missing now and then.

    Args:
        controller: From `jnx.control.mpc`.
        name: Name of the files and their functions.

    Returns:
        `NAME_control.h` and `NAME_control.c`; `difference` is that of decisions, in
        shares of the commands' ranges and of quarters of the outputs', `program` that
        of the model. Without a C compiler `left_out` says that nothing was run.

    Raises:
        ExportError: the C does not compile, or decides otherwise.

    Example:
        free = {"a": jnx.control.Command(rate=2.0)}
        controller = jnx.control.mpc(network, free, ["y"], horizon=8).value
        found = jnx.control.export_controller(controller, name="engine")
        print(found.files["engine_control.h"])
    """
    control = control_program(controller, name)
    files = control_files(control)
    if compiler() is None:
        left_out = ("c, controller: there is no C compiler here",)
        return Exported(control.program, files, {}, left_out, {})
    with TemporaryFolder() as place:
        write_files(Path(place), files)
        sizes = {
            "commands": len(controller.commands),
            "limits": len(controller.bounded),
        }
        run = controller_runner(Path(place), control.program.name, **sizes)
        off = _difference(controller, run)
    if not off <= AGREEMENT:
        raise ExportError(
            f"decisions of the C differ from those of the controller by {off:.3g} of "
            f"the ranges, more than {AGREEMENT:g}"
        )
    return Exported(control.program, files, {"c, controller": off}, (), {})


def control_program(controller: Controller, name: str) -> ControlProgram:
    """Lower the network of a controller, and list sizes and numbers for its C."""
    network = controller.network
    # What is reported as NaN is computed all the same, as in `Network.step`.
    outside = FLAG if network.outside == NAN else network.outside
    told = dataclasses.replace(network, outside=outside, nan=HOLD)
    program_ = lower(told, name, index=False, slopes=False)
    count, soft = len(network.modelled), list(controller.bounded)
    own = np.array(controller.bounded, int)
    largest = np.asarray(largest_sizes(network))
    outputs = np.array(network.signals)[:count]
    size = np.asarray(controller.size)
    high = (np.asarray(controller.ceiling) - np.asarray(controller.guard)) / size[own]
    low = (np.asarray(controller.floor) + np.asarray(controller.guard)) / size[own]
    linear, square = [LINEAR] * len(soft), [SQUARE] * len(soft)
    used, fade = used_inputs(controller).tolist(), np.zeros(0)
    whiten, middle = np.zeros(0), np.zeros(0)
    if controller.domain is not None and controller.fade is not None:
        domain, fade = controller.domain, np.asarray(controller.fade)
        whiten = np.asarray(domain.whiten) / np.asarray(domain.spread)[None]
        whiten = (whiten / np.asarray(domain.border)[2]).ravel()
        middle = np.asarray(domain.middle)
        soft, high, low = [*soft, count], np.append(high, 1.0), np.append(low, -np.inf)
        linear, square = [*linear, DOMAIN_LINEAR], [*square, DOMAIN_SQUARE]
    known, commands = controller.statistics, list(controller.commands)
    return ControlProgram(
        program=program_,
        inputs=tuple(controller.input_names),
        counts={
            "HORIZON": controller.horizon,
            "FIRST": controller.first,
            "ROUNDS": controller.rounds,
            "BLOCKS": len(controller.blocks),
            "COMMANDS": len(commands),
            "GIVEN": len(controller.given),
            "TARGETS": len(controller.targets),
            "LIMITS": len(controller.bounded),
            "MOST_STEPS": MOST_STEPS,
            "REST_STEPS": REST_STEPS,
        },
        constants={
            "AT_EDGE": AT_EDGE,
            "LEAST_CURVATURE": LEAST_CURVATURE,
            "LEAST_ROOT": LEAST_DISTANCE**0.5,
            "NEAR_BORDER": NEAR_BORDER,
            "NOT_MEASURED": NOT_MEASURED,
            "REST_TOLERANCE": REST_TOLERANCE,
            "ROUND_OFF": ROUND_OFF,
            "SOLVED": SOLVED,
            "TOLERANCE": TOLERANCE,
        },
        integers={
            "block_of": block_of(controller).tolist(),
            "block_start": list(controller.blocks),
            "command_at": commands,
            "given_at": list(controller.given),
            "target_at": list(controller.targets),
            "soft_column": soft,
            "used_at": used,
            "used_command": [commands.index(c) if c in commands else -1 for c in used],
        },
        reals={
            "low": np.asarray(controller.low),
            "high": np.asarray(controller.high),
            "largest_move": np.asarray(controller.move),
            "effort": np.asarray(controller.effort),
            "span": np.asarray(controller.span),
            "weight_of": np.asarray(controller.weight),
            "size": size,
            "soft_high": high,
            "soft_low": low,
            "soft_linear": np.array(linear),
            "soft_square": np.array(square),
            "pole": np.asarray(known.pole),
            "noise_variance": np.asarray(known.noise),
            "offset_variance": np.asarray(known.offset),
            "fading_variance": np.asarray(known.steps),
            "fade": fade,
            "whiten": whiten,
            "middle_of": middle,
            "largest_input": largest[np.array(driving_signals(network), int)],
            "largest_output": largest[outputs],
            "input_middle": np.asarray(middle_inputs(network)),
        },
        loops=_loops(controller),
        observe_states=controller.observe_states,
        unsure=UNSURE,
        bounds=_bounds(network),
    )


def _loops(controller: Controller) -> tuple[FeedbackLine, ...]:
    """List the delay lines that the network feeds back."""
    network = controller.network
    names, lags = identifiers(network.computed_names), depth(network)
    low, high, gain = (np.asarray(a) for a in (network.low, network.high, network.gain))
    variances = np.asarray(controller.statistics.states).reshape(-1, max(lags, 1))
    groups: dict[int, int] = {}
    found = []
    for n, o in enumerate(np.asarray(sources(network)).tolist() if lags else []):
        line, signal, rooted = f"y_{names[o]}", network.signals[o], False
        middle, size = 0.5 * (low[signal] + high[signal]), float(gain[signal])
        if n >= len(network.models):
            groups[o] = groups.get(o, 0) + 1
            line, root = f"{line}_group{groups[o]}", network.models[o].root
            if root is not None and bool(root.squares[groups[o] - 1]):
                rooted, floor = True, float(root.floor[groups[o] - 1])
                middle = middle - floor * size
        output = o if n < len(network.modelled) else None
        own = tuple(float(v) for v in variances[n])
        found.append(FeedbackLine(line, output, size, float(middle), rooted, own))
    return tuple(found)


def _bounds(network: Network) -> tuple[tuple[float, float, bool], ...] | None:
    """The bounds of the feedback as numbers."""
    found = feedback_bounds(network)
    if found is None:
        return None
    low, high, free = (np.asarray(a).tolist() for a in found)
    return tuple(zip(low, high, free, strict=True))


def _difference(controller: Controller, run: ControllerRun) -> float:
    """The largest difference of a decision over the runs of a proof, each as far as
    round-off does not decide; ExportError where that is not far enough."""
    apart, counts, total = [], np.zeros(3, int), STRETCHES * SAMPLES
    for seed in range(STRETCHES):
        begun, wanted, given, off = scenario = _scenario(controller, seed)
        measured, expected = _drive_host(controller, scenario)
        near = off + ROUND_OFF_SHARE * np.asarray(controller.size)
        second = _drive_host(controller, (begun, wanted, given, near))[1]
        found = Decision(*map(jnp.asarray, run(begun, measured, wanted, given)))
        together = _measure_difference(controller, second, expected) <= TOGETHER
        together |= ~expected.solved
        together = np.logical_and.accumulate(together & _same_flags(second, expected))
        alike = np.logical_and.accumulate(_same_flags(found, expected) | ~together)
        kept = together & alike & expected.solved
        counts += [(~expected.solved).sum(), (~together).sum(), (~alike).sum()]
        apart.append(_measure_difference(controller, found, expected)[kept])
    every = np.concatenate(apart)
    if len(every) < LEAST_SHARE * total:
        unsolved, loose, other = counts
        raise ExportError(
            f"only {len(every)} of the {total} samples of the proof can be compared: "
            f"{unsolved} quadratic programs of the controller are not solved, "
            f"{loose} samples lie where round-off decides, and {other} behind one that "
            "the C has solved, or begun anew, alone. Look at a closed loop, and at "
            "references and limits that it can keep"
        )
    return float(np.max(np.where(np.isnan(every), np.inf, every)))


def _same_flags(one: Decision, other: Decision) -> np.ndarray:
    same = (one.solved == other.solved) & (one.restarted == other.restarted)
    return np.asarray(same)


def _drive_host(
    controller: Controller, scenario: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, Decision]:
    """Measured outputs and decisions of `_drive` as arrays of numpy."""
    measured, decisions = _drive(controller, *map(jnp.asarray, scenario))
    return np.asarray(measured), jax.tree.map(np.asarray, decisions)


def _measure_difference(
    controller: Controller, found: Decision, expected: Decision
) -> np.ndarray:
    """The largest difference of each decision, in ranges."""
    size = np.asarray(controller.size)
    own = {
        "commands": np.asarray(controller.span),
        "outputs": size,
        "excess": size[np.array(controller.bounded, int)],
        "disturbance": size,
    }
    parts = []
    for name, scale in own.items():
        off = np.abs(getattr(found, name) - getattr(expected, name)) / scale
        parts.append(off.reshape(SAMPLES, -1))
    return np.concatenate(parts, axis=1).max(axis=1)


def _scenario(controller: Controller, seed: int) -> tuple[np.ndarray, ...]:
    """Inputs to begin with, references and given inputs over the horizon of every
    sample, and what measurements are off by."""
    network, random = controller.network, np.random.default_rng(seed)
    low, high = np.asarray(network.low), np.asarray(network.high)
    signals = np.array(driving_signals(network), int)
    outputs = np.array(network.signals)[: len(network.modelled)]
    ahead = np.arange(SAMPLES)[:, None] + np.arange(controller.horizon)[None]

    def steps(columns, hold):
        """Levels up to a tenth beyond the ranges, by the samples of every horizon."""
        shape = int(ahead.max()) // hold + 1, len(columns)
        levels = random.uniform(-BEYOND, 1.0 + BEYOND, shape)
        levels = low[columns] + (high - low)[columns] * levels
        return levels[ahead // hold]

    wanted = steps(outputs[list(controller.targets)], 10)
    given = steps(signals[list(controller.given)], 15)
    noise = random.normal(size=(SAMPLES + 1, len(outputs)))
    noise = np.where(random.uniform(size=noise.shape) < MISSING, np.nan, noise)
    begun = low[signals] + (high - low)[signals] * random.uniform(0.25, 0.75)
    begun[list(controller.given)] = given[0, 0]
    given[random.uniform(size=given.shape) < MISSING] = np.nan
    off = np.asarray(controller.size) * (OFF + NOISE * noise)
    return begun, wanted, given, off


@program
def _drive(
    controller: Controller, begun: Array, wanted: Array, given: Array, off: Array
) -> tuple[Array, Decision]:
    """Run the controller on its own network from rest: measured outputs, decisions."""
    network = controller.network
    x = network.init("steady", begun[None])
    first = network.step(x, begun)[1] + off[0]

    def sample(carry, rows):
        x, state, last = carry
        wanted, given, off = rows
        measured = network.step(x, last)[1] + off
        state, decision = controller.step(state, measured, wanted, given)
        return (network.step(x, state.u)[0], state, state.u), (measured, decision)

    start = x, controller.begin(begun, first), begun
    rows = wanted, given, off[1:]
    measured, decisions = jax.lax.scan(sample, start, rows)[1]
    return jnp.concatenate([first[None], measured]), decisions
