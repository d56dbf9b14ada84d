"""Linear state-space models in discrete time: their run, their poles, their forms.

x(t+1) = A x(t) + B u(t) + b, y(t) = C x(t) + D u(t) + d. With x = T z + m and T of full
rank, z obeys the same equations with T^-1 A T, T^-1 B, T^-1 (A m + b - m), C T, D and
C m + d: the outputs leave the coordinates of the state open.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require
from jaxnarx.errors import DataError

CIRCLE_DISTANCE = 1e-3
"""How far from the unit circle poles are kept."""
LEAST_DEVIATION_SHARE = 1e-8
"""Standard deviation that a state is scaled by at least, of the largest one."""


@dataclasses.dataclass(frozen=True, eq=False)
class StateSpace:
    """x(t+1) = a x(t) + b u(t) + state_offset, y(t) = c x(t) + d u(t) + output_offset.

    Inputs and outputs in their own units. Over the data it was identified from every
    state has mean zero and standard deviation one. `start` is the state at every
    record's first valid sample (zero, the mean, where a record has none).

    `singular` are the singular values of the projected future outputs, whatever the
    order: they fall to the level of the noise behind the order that the data tell.
    """

    a: Float[np.ndarray, "states states"]
    b: Float[np.ndarray, "states inputs"]
    state_offset: Float[np.ndarray, " states"]
    c: Float[np.ndarray, "outputs states"]
    d: Float[np.ndarray, "outputs inputs"]
    output_offset: Float[np.ndarray, " outputs"]
    start: Float[np.ndarray, "records states"]
    singular: Float[np.ndarray, " values"]

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.a)

    @property
    def poles(self) -> Complex[np.ndarray, " states"]:
        """Eigenvalues of `a`, slowest first."""
        found = np.linalg.eigvals(self.a).astype(complex)
        return found[np.argsort(-np.abs(found), kind="stable")]

    def free_run_error(
        self, u: Sequence[Any], y: Sequence[Any], valid: Sequence[Any] | None = None
    ) -> float:
        """Mean square of what the valid outputs of all free runs are off, from the
        model's own starting states; an array (time, inputs), one (time, outputs) and
        booleans (time,) for every record."""
        squares = []
        for k, (one, other) in enumerate(zip(u, y, strict=True)):
            good = slice(None) if valid is None else valid[k]
            run = simulate_state_space(self, one, self.start[k])
            squares.append(((run - other)[good] ** 2).ravel())
        return float(np.concatenate(squares).mean())


@guard_arguments
def simulate_state_space(
    model: StateSpace, u: Any, x0: Any
) -> Float[np.ndarray, "time outputs"]:
    """Free run from the state `x0` at the first of the inputs `u`, (time, inputs).

    The run of an unstable model may end in infinities.
    """
    u = np.asarray(u, float)
    x = simulate_states(model, u, x0)
    with np.errstate(over="ignore", invalid="ignore"):
        return x @ model.c.T + u @ model.d.T + model.output_offset[None]


@guard_arguments
def simulate_states(
    model: StateSpace, u: Any, x0: Any
) -> Float[np.ndarray, "time states"]:
    """The states of that run."""
    u, x0 = np.asarray(u, float), np.asarray(x0, float)
    inputs = model.b.shape[1]
    require(
        u.ndim == 2 and u.shape[1] == inputs and x0.shape == (model.order,),
        "u",
        f"expected u of shape (time, {inputs}) and x0 of shape ({model.order},), got "
        f"{u.shape} and {x0.shape}",
    )
    drive = u @ model.b.T + model.state_offset[None]
    with np.errstate(over="ignore", invalid="ignore"):
        return recursion(model.a.T, drive[:, None], x0[None])[:-1, 0]


def recursion(
    a: Float[np.ndarray, "n n"],
    drive: Float[np.ndarray, "time rows n"],
    first: Float[np.ndarray, "rows n"],
) -> Float[np.ndarray, "after rows n"]:
    """q(t+1) = q(t) a + drive(t) from q(0) = `first`; one row more than `drive`.

    A loop over time costs two microseconds a step, and unlike filters in modal form it
    is exact for poles that coincide, as those of a dead time do.
    """
    q = np.concatenate([first[None], drive])
    for t in range(len(drive)):
        q[t + 1] += q[t] @ a
    return q


def stabilise(
    a: Float[np.ndarray, "states states"], *, integrating: bool = False
) -> Float[np.ndarray, "states states"]:
    """`a` with all its eigenvalues inside the unit circle.

    One outside goes to its mirror image, 1/conj, one within `CIRCLE_DISTANCE` of the
    circle then to 1 - `CIRCLE_DISTANCE`. With `integrating`, real ones within
    `CIRCLE_DISTANCE` of one become one.

    All this keeps the angles, so that the diagonal blocks of the real Schur form are
    multiplied by numbers: no eigenvectors, which poles that coincide lack, are needed.
    """
    t, z = scipy.linalg.schur(a, output="real")[:2]
    wide = np.append(np.diagonal(t, -1) != 0, False)
    moved, k = False, 0
    while k < len(a):
        block = slice(k, k + 1 + int(wide[k]))
        # The modulus of a complex pair is the root of its block's determinant.
        pole = float(np.sqrt(np.linalg.det(t[block, block]))) if wide[k] else t[k, k]
        wanted = _radius(pole, integrating=integrating and not wide[k])
        if wanted != abs(pole):
            t[block, block] *= wanted / abs(pole)
            moved = True
        k = block.stop
    return z @ t @ z.T if moved else a


def _radius(pole: float, *, integrating: bool) -> float:
    """The modulus to which a pole, by its modulus if complex, is moved."""
    if integrating and abs(pole - 1) <= CIRCLE_DISTANCE:
        return 1.0
    size = abs(pole)
    return min(1 / size if size > 1 else size, 1 - CIRCLE_DISTANCE)


def scale_states(
    model: StateSpace,
    states: Float[np.ndarray, "samples states"],
    form: str,
) -> StateSpace:
    """The same model in `form`, with `states` of mean zero and standard deviation one.

    A state that moves less than `LEAST_DEVIATION_SHARE` of the one that moves most is
    scaled as if it moved that much: what is rounding is not blown up to one.
    """
    basis = modal_basis(model.a) if form == "modal" else np.eye(model.order)
    mean = states.mean(axis=0)
    moved = np.linalg.solve(basis, (states - mean[None]).T)
    spread = moved.std(axis=1)
    most = float(spread.max())
    spread = (
        np.maximum(spread, LEAST_DEVIATION_SHARE * most)
        if most > 0
        else np.ones(model.order)
    )
    found = transform(model, basis * spread[None], mean)
    if form != "modal":
        return found
    # Beside the blocks stands rounding.
    return dataclasses.replace(found, a=np.where(_blocks(model.a), found.a, 0.0))


def transform(
    model: StateSpace,
    basis: Float[np.ndarray, "states states"],
    mean: Float[np.ndarray, " states"],
) -> StateSpace:
    """Change to coordinates z, x = `basis` z + `mean`."""
    drift = model.a @ mean + model.state_offset - mean
    inside = np.column_stack([model.a @ basis, model.b, drift])
    inside = np.linalg.solve(basis, inside)
    order = model.order
    return dataclasses.replace(
        model,
        a=inside[:, :order],
        b=inside[:, order:-1],
        state_offset=inside[:, -1],
        c=model.c @ basis,
        output_offset=model.c @ mean + model.output_offset,
        start=np.linalg.solve(basis, (model.start - mean[None]).T).T,
    )


def modal_basis(
    a: Float[np.ndarray, "states states"],
) -> Float[np.ndarray, "states states"]:
    """Columns that bring `a` to blocks of 1 x 1 and, of complex pairs, 2 x 2.

    Slowest first. `DataError` where poles nearly coincide: they have no such form.
    """
    values, vectors = _eigen(a)
    basis = np.where(np.imag(values)[None] < 0, -np.imag(vectors), np.real(vectors))
    if np.linalg.cond(basis) > 1 / np.sqrt(np.finfo(float).eps):
        raise DataError(
            "two poles of the model nearly coincide, so that it has no modal form; use "
            "form='balanced' or another order"
        )
    return basis


def _blocks(a: Float[np.ndarray, "states states"]) -> np.ndarray:
    """True for the entries that the modal form of `a` has."""
    values = _eigen(a)[0]
    same = np.abs(values[:, None] - values[None].conj()) == 0
    return np.eye(len(a), dtype=bool) | (same & (np.imag(values) != 0)[:, None])


def _eigen(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, slowest first, and eigenvectors; pairs stay side by side."""
    values, vectors = np.linalg.eig(a)
    order = np.argsort(-np.abs(values), kind="stable")
    return values[order].astype(complex), vectors[:, order].astype(complex)
