"""C of the state form for acados: next state, Jacobian and Hessian.

The functions have the names and the calling convention of those that CasADi writes and
acados links for discrete dynamics: `arg` are x, u (and multipliers lam) and the empty
p; the Jacobian is that of the next state by (u, x), transposed, the Hessian that of lam
times the next state; matrices by columns, dense. Neither CasADi nor acados is needed to
write or to compile them. Inputs are finite: what other targets keep for missing ones is
left out. R. Verschueren and others, acados, Mathematical Programming Computation 14,
2022.
"""

import ctypes
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from jaxnarx.exporters.c99 import table_lines
from jaxnarx.exporters.code import Syntax, comment, statements, value_text
from jaxnarx.exporters.compilers import compiler, load_library
from jaxnarx.exporters.form import Op, SampleProgram, Value
from jaxnarx.exporters.proof import (
    DOUBLE_TOLERANCE,
    Case,
    ExportError,
    Runner,
    worst,
)
from jaxnarx.exporters.state_program import (
    StateProgram,
    name_states,
    state_syntax,
    without_gaps,
)
from jaxnarx.exporters.target import Files, Golden, Proof

SLOPE_TOLERANCE = 1e-4
"""Largest difference of a slope to that of central differences, in shares of the
largest, at some samples of the proof; exact beside CasADi in the tests."""
SLOPES_TRIED = 3
DIFFERENCE = 1e-5


def acados_files(program: SampleProgram, golden: Golden) -> Files:
    """One file of C."""
    del golden
    return {f"{program.name}_acados.c": _source(StateProgram.of(program, hessian=True))}


def _source(form: StateProgram) -> str:
    program = form.program
    name, upper = program.name, program.name.upper()
    states, inputs = list(name_states(program)), program.inputs
    nx, nu, ny = len(states), len(inputs), len(program.outputs)
    syntax = state_syntax(program)
    both = nu + nx
    x, u, p, lam = (nx, 1), (nu, 1), (0, 0), (nx, 1)
    jac, hess = (both, nx), (both, both)
    functions = {
        "dyn_disc_phi_fun": ([x, u, p], [(form.after, x)]),
        "dyn_disc_phi_fun_jac": (
            [x, u, p],
            [(form.after, x), (_flat(form.jacobian), jac)],
        ),
        "dyn_disc_phi_fun_jac_hess": (
            [x, u, lam, p],
            [
                (form.after, x),
                (_flat(form.jacobian), jac),
                (_flat(form.hessian), hess),
            ],
        ),
        "out_fun": ([x, u, p], [(program.outputs, (ny, 1))]),
        "out_fun_jac": (
            [x, u, p],
            [(program.outputs, (ny, 1)), (_flat(form.out_jacobian), (both, ny))],
        ),
    }
    lines = [
        f"/* {name}: the model as x(t+1) = f(x(t), u(t)), y(t) = out(x(t), u(t)).",
        " *",
        f" *   {name}_dyn_disc_phi_fun, _jac and _jac_hess are what acados links for",
        f" *   discrete dynamics of a model of this name, {nx} states and {nu} inputs.",
        f" *   {name}_x_begin(u, y, x), then {name}_x_observe(u, y, x) for each of",
        f" *   {program.history} samples of measured history: the state to begin with.",
        " *",
        f" * A sample every {program.sample_time:g} s. Inputs, physical and finite:",
        *(f" *   u[{k}] {comment(port.name)}" for k, port in enumerate(inputs)),
        " * State, past outputs divided by their gains:",
        *(f" *   x[{k}] {comment(state)}" for k, state in enumerate(states)),
        " */",
        "#include <math.h>",
        "#include <stddef.h>",
        "#include <string.h>",
        "",
        f"#define {name}_real double",
        f"#define {upper}_EXP(a) exp(a)",
        f"#define {upper}_SQRT(a) sqrt(a)",
        "",
    ]
    for table in program.tables:
        lines += table_lines(name, table, static=True)
    lines += _beginnings(program, syntax)
    for suffix, (takes, gives) in functions.items():
        lines += _function(program, syntax, f"{name}_{suffix}", takes, gives)
    return "\n".join(lines) + "\n"


def _flat(rows: Iterable[Iterable[Value]]) -> tuple[Value, ...]:
    """Rows of slopes one behind the other: columns of the transposed matrix."""
    return tuple(value for row in rows for value in row)


def _beginnings(program: SampleProgram, syntax: Syntax) -> list[str]:
    """Functions that make the state to begin with."""
    name, lines = program.name, []
    begun, seen = [], []
    for line in program.delays:
        begun += [value_text(program, line.start, syntax)] * line.length
        now = value_text(program, line.measured, syntax)
        first = len(seen)
        seen += [now, *(f"x[{first + k}]" for k in range(line.length - 1))]
    for state in program.states:
        begun.append(value_text(program, state.start, syntax))
        seen.append(value_text(program, state.source, syntax))
    for what, needed, values in (
        ("begin", program.begin, begun),
        ("observe", program.observe, seen),
    ):
        head = f"void {name}_x_{what}(const double *u, const double *y, double *x)"
        lines += [
            f"{head};",
            head,
            "{",
            *statements(program, needed, syntax),
            f"    const double now[{max(len(values), 1)}] = {{",
            *(f"        {value}," for value in values or ["0.0"]),
            "    };",
            "    int k;",
            "    (void)u;",
            "    (void)y;",
            f"    for (k = 0; k < {len(values)}; k++) {{",
            "        x[k] = now[k];",
            "    }",
            "}",
            "",
        ]
    return lines


def _function(
    program: SampleProgram,
    syntax: Syntax,
    name: str,
    takes: Sequence[tuple[int, int]],
    gives: Sequence[tuple[Sequence[Value], tuple[int, int]]],
) -> list[str]:
    """A function, and those that tell its arguments, results and memory."""
    with_lam = len(takes) > 3
    head = f"int {name}(const double **arg, double **res, int *iw, double *w, int mem)"
    asked = [value for values, _ in gives for value in values]
    lines = [
        f"{head};",
        head,
        "{",
        "    const double *const x = arg[0];",
        "    const double *const u = arg[1];",
        *(["    const double *const lam = arg[2];"] if with_lam else []),
        *statements(program, program.needed_operations(asked), syntax),
        "    (void)x;",
        "    (void)u;",
        *(["    (void)lam;"] if with_lam else []),
        "    (void)iw;",
        "    (void)w;",
        "    (void)mem;",
    ]
    zero = program.ops.index(Op("const", source=0.0))
    for n, (values, _) in enumerate(gives):
        lines += [
            f"    if (res[{n}] != NULL) {{",
            f"        memset(res[{n}], 0, {len(values)} * sizeof(double));",
            *(
                f"        res[{n}][{k}] = {value_text(program, value, syntax)};"
                for k, value in enumerate(values)
                if value != zero
            ),
            "    }",
        ]
    lines += ["    return 0;", "}"]
    for what, count in (("in", len(takes)), ("out", len(gives))):
        lines += [
            f"int {name}_n_{what}(void);",
            f"int {name}_n_{what}(void) {{ return {count}; }}",
        ]
    for what, shapes in (("in", list(takes)), ("out", [shape for _, shape in gives])):
        rows = ", ".join(f"{{{a}, {b}, 1}}" for a, b in shapes)
        lines += [
            f"const int *{name}_sparsity_{what}(int n);",
            f"const int *{name}_sparsity_{what}(int n)",
            "{",
            f"    static const int shape[{len(shapes)}][3] = {{{rows}}};",
            f"    return ((n >= 0) && (n < {len(shapes)})) ? shape[n] : NULL;",
            "}",
        ]
    return [
        *lines,
        f"int {name}_work(int *arg, int *res, int *iw, int *w);",
        f"int {name}_work(int *arg, int *res, int *iw, int *w)",
        "{",
        *(
            f"    if ({word} != NULL) {{ *{word} = {size}; }}"
            for word, size in (
                ("arg", len(takes)),
                ("res", len(gives)),
                ("iw", 0),
                ("w", 0),
            )
        ),
        "    return 0;",
        "}",
        "",
    ]


class AcadosLibrary:
    """The file of `folder`, compiled there, as functions of numpy arrays."""

    def __init__(self, folder: Path, program: SampleProgram) -> None:
        self.program, source = program, folder / f"{program.name}_acados.c"
        self.library = load_library([source], source.with_suffix(".so"), ["-O1"])

    def call(self, suffix: str, *given: np.ndarray) -> list[np.ndarray]:
        """Results of one of the functions, matrices as they are meant."""
        base = f"{self.program.name}_{suffix}"
        shape_of = getattr(self.library, f"{base}_sparsity_out")
        shape_of.restype = ctypes.POINTER(ctypes.c_int)
        count = getattr(self.library, f"{base}_n_out")()
        shapes = [tuple(shape_of(n)[:2]) for n in range(count)]
        results = [np.zeros(shape, order="F") for shape in shapes]
        kept = [np.ascontiguousarray(a, float) for a in given] + [np.zeros(1)]
        pointer = ctypes.POINTER(ctypes.c_double)
        arguments = (pointer * len(kept))(*(a.ctypes.data_as(pointer) for a in kept))
        places = (pointer * count)(*(a.ctypes.data_as(pointer) for a in results))
        getattr(self.library, base)(arguments, places, None, None, 0)
        return results

    def begin(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The state at rest."""
        return self._begin(
            "begin", u, y, np.zeros(len(list(name_states(self.program))))
        )

    def observe(self, u: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """The state after a sample of measured history."""
        return self._begin("observe", u, y, x)

    def _begin(self, what: str, u, y, x) -> np.ndarray:
        buffer = np.concatenate([x, np.zeros(1)])  # none of length zero
        arrays = [np.ascontiguousarray(a, float) for a in (u, y)] + [buffer]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        getattr(self.library, f"{self.program.name}_x_{what}")(*pointers)
        return buffer[: len(x)]

    def states(self, inputs: np.ndarray, measured: np.ndarray) -> Iterator[np.ndarray]:
        """The state before every sample of the free run."""
        history = self.program.history
        x = self.begin(inputs[0], measured[0])
        for u, y in zip(inputs[:history], measured, strict=False):
            x = self.observe(u, y, x)
        for u in inputs[history:]:
            yield x
            x = self.call("dyn_disc_phi_fun", x, u)[0].ravel()


def acados_runner(library: AcadosLibrary) -> Runner:
    """The free run, sample by sample."""

    def run(inputs, measured):
        rows = inputs[library.program.history :]
        states = library.states(inputs, measured)
        pairs = zip(states, rows, strict=True)
        return np.array([library.call("out_fun", x, u)[0].ravel() for x, u in pairs])

    return run


def prove_acados(program: SampleProgram, folder: Path, cases: Sequence[Case]) -> Proof:
    """The file of `folder`, compiled, beside the model where inputs are finite, and its
    slopes beside central differences."""
    if compiler() is None:
        return {}, ["acados: there is no C compiler here"]
    library = AcadosLibrary(folder, without_gaps(program))
    finite = [case for case in cases if np.all(np.isfinite(case.inputs))]
    if not finite:
        return {}, ["acados: no record of the proof has finite inputs throughout"]
    found = worst(finite, acados_runner(library), DOUBLE_TOLERANCE, "C for acados")
    _prove_slopes(library, finite[0])
    return {"acados": found}, []


def _prove_slopes(library: AcadosLibrary, case: Case) -> None:
    rows = case.inputs[library.program.history :]
    at = np.linspace(0, len(rows) - 1, SLOPES_TRIED).astype(int).tolist()
    states, off = list(library.states(case.inputs, case.measured)), []
    wide = np.array([p.high - p.low for p in library.program.inputs])
    for n in at:
        x, u = states[n], rows[n]
        slopes = library.call("dyn_disc_phi_fun_jac", x, u)[1]
        size = np.concatenate([np.where(wide > 0, wide, 1.0), np.ones(len(x))])
        expected = np.zeros_like(slopes)
        for k, step in enumerate(DIFFERENCE * size):
            ends = []
            for way in (step, -step):
                moved = np.concatenate([u, x])
                moved[k] += way
                v, z = moved[: len(u)], moved[len(u) :]
                ends.append(library.call("dyn_disc_phi_fun", z, v)[0].ravel())
            expected[k] = (ends[0] - ends[1]) / (2 * step)
        size = size[:, None]
        most = np.max(np.abs(slopes) * size, initial=1e-12)
        off.append(np.max(np.abs(slopes - expected) * size, initial=0.0) / most)
    # At a kink there is no slope; not all of the samples lie at one.
    if not np.median(off) <= SLOPE_TOLERANCE:
        raise ExportError(
            f"slopes of the C for acados are off by {np.median(off):.2g} of the largest"
        )
