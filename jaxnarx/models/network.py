"""The model: local polynomials of lagged variables, blended by validity functions.

    y_o(t) = sum_m phi_m(z_t) sum_k theta[m, k] p_(m,k)(v_t)

One class serves every model of this package: a NARX model is a network with one local
model, a model of several outputs has a partition and terms for each, and a model with
hidden states has outputs that nobody measures: channels with terms, partition and
bounds of their own, which enter terms and scheduling as simulated outputs do. A
state-space model is one of them, with z(t) the state after sample t,

    z(t) = f(z(t-1), u(t)) ,   y(t) = g(z(t-1), u(t)) .
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxnarx.arrays import twin
from jaxnarx.checks import whole
from jaxnarx.data import Channel, Channels, number_channels
from jaxnarx.deprecation import old_method
from jaxnarx.errors import SpecError
from jaxnarx.formatting import count, page
from jaxnarx.models.domain import Domain
from jaxnarx.models.error_model import ErrorModel
from jaxnarx.models.outside import FLAG, HOLD, LINEAR, NAN, OUTSIDE, OUTSIDE_WORDS
from jaxnarx.models.signed_root import SignedRoot
from jaxnarx.models.validity import AbstractValidity
from jaxnarx.regressors import (
    Variables,
    equation,
    evaluate,
    record_columns,
    term_name,
    variable_names,
)

Arrays = Array | np.ndarray

MISSING = HOLD, NAN
"""Policies for outputs where an input is missing: those of the last finite input, or
not a number."""
SATURATION_TOLERANCE = 1e-9
"""Share of its range by which the bound of a channel that saturates may differ from
the end of the range."""
UNBOUNDED_WIDTHS = 1e4
"""Feedback bounds of more trained widths than these are none to speak of."""
SHOWN_TERMS = 6
"""Terms of a local model that `print` shows; `equations` has them all."""


class LocalModels(eqx.Module):
    """Polynomials linear in their coefficients; every local model has its own terms.

    `factor` lists the distinct terms, `index` says which of them slot s of model m
    uses, `used` is False for padding. Coefficients belong to gain-scaled signals.
    """

    factor: Int[Array, "terms degree"]
    index: Int[Array, "models slots"]
    used: Bool[Array, "models slots"]
    coefficient: Float[Array, "models slots"]

    def dense(self) -> Float[Array, "models terms"]:
        """Coefficients over the table of distinct terms."""
        models, shape = len(self.index), (len(self.index), len(self.factor))
        if isinstance(self.coefficient, Tracer) or isinstance(self.index, Tracer):
            value = jnp.where(self.used, self.coefficient, 0.0)
            table = jnp.zeros(shape, value.dtype)
            return table.at[jnp.arange(models)[:, None], self.index].add(value)
        # The same on the host, where no program has to be made for every shape.
        value = np.where(self.used, self.coefficient, 0.0)
        table = np.zeros(shape, value.dtype)
        np.add.at(table, (np.arange(models)[:, None], np.asarray(self.index)), value)
        return jax.device_put(table)


class OutputModel(eqx.Module):
    """The part of a network that computes one output: its partition and local models.

    Scheduling variables are min-max scaled, z = (x - offset)/span, in physical units of
    x; `active` is False for unused model slots. In `own` every row is a group of local
    models that are fed back their own past output in a free run, the mean of the group
    by its weights, not that of the network: a local model alone is an output-error
    model of its region, the local models of a network within a sum of networks are a
    group. A local model is in one group at most; a square table holds none but groups
    of one, and rows without any. Without `own` there is none. Groups with a `root`
    compute a root of the output: that is what their own lags are in their terms, while
    all that a run carries are outputs.
    """

    scheduling: Variables = eqx.field(static=True)
    offset: Float[Array, " dims"]
    span: Float[Array, " dims"]
    validity: AbstractValidity
    active: Bool[Array, " models"]
    local: LocalModels
    own: Bool[Array, "groups models"] | None = None
    root: SignedRoot | None = None

    def __call__(
        self, v: Float[Array, "vars *rows"], z: Float[Array, "dims *rows"]
    ) -> Float[Array, "*rows"]:
        """Scaled output at one sample or at many (trailing axes)."""
        return self.blend(jnp.asarray(evaluate(self.local.factor, v)), z)

    def blend(
        self, terms: Float[Array, "terms *rows"], z: Float[Array, "dims *rows"]
    ) -> Float[Array, "*rows"]:
        """The same from the values of the terms, which all local models have in
        common."""
        local = jnp.tensordot(self.local.dense(), terms, axes=1)
        return self.add_up(self.validity(z, self.active), local)[0]

    def add_up(
        self, phi: Float[Array, "models *rows"], local: Float[Array, "models *rows"]
    ) -> tuple[Float[Array, "*rows"], Float[Array, "groups *rows"]]:
        """The output, and those of all groups, from weights and local models."""
        if self.own is None:
            return jnp.sum(phi * local, axis=0), phi[:0]
        computed = jnp.sum(self.shares(phi) * local[None], axis=1)
        if self.root is None:
            return jnp.sum(phi * local, axis=0), computed
        groups = self.root.to_output(computed)
        return jnp.sum(self.rest(phi) * local, axis=0) + jnp.sum(
            self.group_weights(phi) * groups, axis=0
        ), groups

    def rest(self, phi: Float[Array, "models *rows"]) -> Float[Array, "models *rows"]:
        """Weights of local models that are in no group; zero of all others."""
        if self.own is None:
            return phi
        member = self.own.any(axis=0)
        return jnp.where(member.reshape(-1, *(1,) * (phi.ndim - 1)), 0.0, phi)

    def group_weights(
        self, phi: Float[Array, "models *rows"]
    ) -> Float[Array, "groups *rows"]:
        """Summed weights of every group's local models."""
        if self.own is None:
            return phi[:0]
        return jnp.tensordot(self.own.astype(phi.dtype), phi, axes=1)

    def shares(
        self, phi: Float[Array, "models *rows"]
    ) -> Float[Array, "groups models *rows"]:
        """Weights of local models within their groups, of sum one.

        Equal weights where all of a group's vanish: a local model alone always has
        weight one.
        """
        assert self.own is not None
        member = self.own.astype(phi.dtype)
        several = (..., *(None,) * (phi.ndim - 1))
        count = jnp.maximum(member.sum(axis=1, keepdims=True), 1.0)
        member, equal = member[several], (member / count)[several]
        weight = member * phi[None]
        total = weight.sum(axis=1, keepdims=True)
        there = total > 0
        total = jnp.where(there, total, 1.0)
        # Far from all of a group the slope has the square of its total, which
        # underflows: quotients of these sizes have not.
        size = jax.lax.stop_gradient(total)
        return jnp.where(there, (weight / size) / (total / size), equal)


class Network(eqx.Module):
    """A multi-model network with everything needed to run it on physical signals.

    `variables` are the lagged variables of all outputs' terms; `modelled` the positions
    of the modelled outputs among `channels.outputs`. `models` computes these and, after
    them, all hidden channels. `gain` brings signals to unit size. `lower` and `upper`
    bound what is simulated (scaled); `low` and `high` are the training ranges in
    physical units; a hidden channel whose bounds are its range saturates there, as a
    part of the model. `outside` says what inputs beyond theirs do, "flag", "hold",
    "linear" or "nan" (`jaxnarx.models.limits`), `hold`, if any, by which share of its
    range a reported output may leave it. `nan` says what outputs are where an input is
    not finite, "hold" or "nan", and `invalid_after` for how many samples in a row they
    are to be trusted then (`jaxnarx.models.missing`). `domain` is what the network
    knows of its training (`jaxnarx.models.domain`), `certificate` a norm of the past
    outputs, newest first, in which it contracts
    (`jaxnarx.refinement.certificate`), `errors` how far measurements lie from
    its free run (`jaxnarx.models.error_model`). A free run starts from `history`
    measured samples, those of local models with their own feedback too; hidden channels
    start from what the outputs of `window` samples before tell about them
    (`jaxnarx.models.observer`). `remembers` is the number of samples for which it
    remembers its inputs; only the copies that programs take, without a domain, have it.
    """

    channels: Channels = eqx.field(static=True)
    modelled: tuple[int, ...] = eqx.field(static=True)
    variables: Variables = eqx.field(static=True)
    models: tuple[OutputModel, ...]
    gain: Float[Array, " signals"]
    lower: Float[Array, " outputs"]
    upper: Float[Array, " outputs"]
    low: Float[Array, " signals"]
    high: Float[Array, " signals"]
    sample_time: Float[Array, ""]
    hold: Float[Array, ""] | None = None
    window: int = eqx.field(static=True, default=0, kw_only=True)
    outside: str = eqx.field(static=True, default=FLAG, kw_only=True)
    nan: str = eqx.field(static=True, default=HOLD, kw_only=True)
    invalid_after: int | None = eqx.field(static=True, default=None, kw_only=True)
    domain: Domain | None = eqx.field(default=None, kw_only=True)
    certificate: Float[Array, "states states"] | None = eqx.field(
        default=None, kw_only=True
    )
    errors: ErrorModel | None = eqx.field(default=None, kw_only=True)
    remembers: Float[Array, ""] | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        for field, words in (("outside", OUTSIDE), ("nan", MISSING)):
            if getattr(self, field) not in words:
                raise SpecError(
                    f"{field} must be one of {', '.join(words)}, got "
                    f"{getattr(self, field)!r}",
                    field=field,
                )
        if self.invalid_after is not None:
            whole(self.invalid_after, "invalid_after")
        if len(self.models) != len(self.modelled) + len(self.channels.hidden):
            raise ValueError(
                f"{len(self.modelled)} modelled outputs and "
                f"{len(self.channels.hidden)} hidden channels but {len(self.models)} "
                "models"
            )
        for table in (self.variables, *(m.scheduling for m in self.models)):
            table.require_measured(self.signals, self.channels.names)

    def __str__(self) -> str:
        """Tell the inputs, the outputs, and the equation of every region."""
        lines = [
            f"Network at {float(self.sample_time):g} s, from {self.history} samples of "
            f"history: {', '.join(self.channels.input_names)} -> "
            + ", ".join(self.output_names)
        ]
        if self.outside != FLAG or self.hold is not None:
            held = f"; {self.margin_text}" if self.hold is not None else ""
            lines.append(f"{OUTSIDE_WORDS[self.outside].sentence}{held}.")
        for o, (name, model) in enumerate(
            zip(self.computed_names, self.models, strict=True)
        ):
            active = np.flatnonzero(np.asarray(model.active)).tolist()
            kind = type(model.validity).__name__
            bound = f", held within {text}" if (text := self.bound_text(o)) else ""
            floors = dict.fromkeys(self._floor(o, m) for m in active)
            roots = [f"{floor:.4g}" for floor in floors if floor is not None]
            of = f", of the root above {' and '.join(roots)}" if roots else ""
            lines.append(
                f"{name}: {len(active)} local "
                f"{'model' if len(active) == 1 else f'models by {kind}'}{of}{bound}"
            )
            for m in active:
                where = _describe_region(self.regions(o)[m]) if len(active) > 1 else ""
                left_out = int(np.asarray(model.local.used)[m].sum()) - SHOWN_TERMS
                more = f" + {count(left_out, 'term')} more" if left_out > 0 else ""
                text = self._equation(o, m, "text", SHOWN_TERMS)["text"]
                lines.append(f"  {m + 1}{where}: {text}{more}")
        return "\n".join(lines)

    _repr_html_ = page

    def bound_text(self, o: int) -> str:
        """The bound of a computed output in words, if it is one: networks that are
        proven bounded have it far beyond all that can be."""
        if self.is_unbounded[o]:
            return ""
        gain = float(np.asarray(self.gain)[self.signals[o]])
        low, high = (float(np.asarray(a)[o]) * gain for a in (self.lower, self.upper))
        unit = f" {unit}" if (unit := self.computed[o].unit) else ""
        return f"{low:.4g} to {high:.4g}{unit}"

    @property
    def saturates(self) -> Bool[Arrays, " computed"]:
        """Whether what is computed stays at its bounds as a part of the model: hidden
        channels alone whose bounds are their ranges. For others to reach their bounds
        is to run away."""
        count, own = len(self.modelled), np.array(self.signals)
        leaves = self.gain, self.low, self.high, self.lower, self.upper
        if not any(isinstance(leaf, Tracer) for leaf in leaves):
            leaves = tuple(np.asarray(leaf) for leaf in leaves)
        (gain, low, high), (lower, upper) = (a[own] for a in leaves[:3]), leaves[3:]
        slack = SATURATION_TOLERANCE * (high - low)
        same = abs(lower * gain - low) <= slack
        same &= abs(upper * gain - high) <= slack
        return same & (high > low) & (np.arange(len(own)) >= count)

    @property
    def is_unbounded(self) -> Bool[np.ndarray, " computed"]:
        """Whether the bound of what is computed is none, being far beyond all that can
        be; host only."""
        own = np.array(self.signals)
        gain, low, high = (np.asarray(a)[own] for a in (self.gain, self.low, self.high))
        widths = (np.asarray(self.upper) - np.asarray(self.lower)) * gain
        return (widths > UNBOUNDED_WIDTHS * (high - low)) & (high > low)

    @property
    def margin_text(self) -> str:
        """The margin by which a reported output may leave its trained range, inputs in
        theirs, in words."""
        share = 0.0 if self.hold is None else 100 * float(self.hold)
        return (
            "Reported outputs stay within their trained ranges, widened by "
            f"{share:g} % of them"
        )

    @property
    def nameless(self) -> "Network":
        """The same with channels that have numbers for names, and without what no run
        needs, for programs."""
        own = self.channels
        counts = len(own.inputs), len(own.outputs), len(own.hidden)
        bare = dict(domain=None, certificate=None, errors=None)
        bare |= dict(nan=HOLD, invalid_after=None, remembers=self._domain_memory())
        return twin(self, channels=number_channels(*counts), **bare)

    def _domain_memory(self) -> Float[Array, ""] | None:
        """The memory of inputs that the domain tells, where a run needs it: what is
        reported widens by it. Samples."""
        if self.domain is None or self.hold is None or self.outside == HOLD:
            return self.remembers
        slowest, step = self.domain.slowest, self.sample_time
        if not slowest:
            return self.remembers
        if isinstance(step, Tracer):
            return slowest / step
        return jax.device_put(np.asarray(slowest / np.asarray(step), step.dtype))

    @property
    def history(self) -> int:
        """Samples needed before the first prediction."""
        scheduling = (m.scheduling.longest for m in self.models)
        return max(self.variables.longest, *scheduling)

    @property
    def before(self) -> int:
        """Samples needed before the first prediction that counts: the history, and the
        window from which hidden channels are estimated."""
        return self.history + self.window

    @property
    def plain(self) -> bool:
        """Whether inputs beyond their ranges are computed with as they are."""
        return self.outside in (FLAG, NAN)

    @property
    def parallel(self) -> bool:
        """Whether local models may be fed back outputs of their own groups."""
        return any(m.own is not None for m in self.models)

    @property
    def signals(self) -> tuple[int, ...]:
        """Signal index of all that is computed: modelled outputs, hidden channels."""
        inputs, measured = len(self.channels.inputs), len(self.channels.measured.all)
        hidden = range(measured, measured + self.hidden)
        return (*(inputs + o for o in self.modelled), *hidden)

    @property
    def used(self) -> tuple[int, ...]:
        """Signals that a term or the scheduling looks at and that are not computed."""
        tables = (self.variables, *(m.scheduling for m in self.models))
        rows = {s for table in tables for s, _ in table}
        return tuple(sorted(rows - set(self.signals)))

    @property
    def hidden(self) -> int:
        """The number of channels that are computed and that nobody measures."""
        return len(self.channels.hidden)

    @property
    def computed(self) -> tuple[Channel, ...]:
        """Channels of the modelled outputs, then hidden ones."""
        return self.output_channels + self.channels.hidden

    @property
    def computed_names(self) -> list[str]:
        """Names of all that is computed."""
        return [c.name for c in self.computed]

    @property
    def output_channels(self) -> tuple[Channel, ...]:
        """Channels of the modelled outputs."""
        return tuple(self.channels.outputs[o] for o in self.modelled)

    @property
    def output_names(self) -> list[str]:
        """Names of the modelled outputs."""
        return [c.name for c in self.output_channels]

    @property
    def variable_names(self) -> list[str]:
        """`speed[t-2]` for every lagged variable."""
        return variable_names(self.channels, self.variables)

    def require_measured(self, what: str) -> None:
        """SpecError where something is asked for that hidden channels have not."""
        if self.hidden:
            raise SpecError(
                f"{what} knows no hidden channels, and the model has "
                f"{', '.join(c.name for c in self.channels.hidden)}: nobody measures "
                "them. Take a model without.",
                field="network",
            )

    @property
    def roots(self) -> list[str]:
        """Names of what is computed by its root."""
        pairs = zip(self.computed_names, self.models, strict=True)
        return [name for name, model in pairs if model.root is not None]

    def require_no_roots(self, what: str) -> None:
        """SpecError where something is asked for that takes local models for parts of
        the output itself."""
        if self.roots:
            raise SpecError(
                f"{what} knows no outputs of which a root is computed, and the model "
                f"has {', '.join(self.roots)}. Take a model without.",
                field="network",
            )

    def tells(self, table: Variables) -> bool:
        """Whether records hold all that a table of variables asks for."""
        measured = len(self.channels.measured.all)
        return all(s < measured for s, _ in table)

    def complete(
        self, signals: Shaped[Array, "*rows measured"]
    ) -> Shaped[Array, "*rows signals"]:
        """Measured signals with zeros behind them for the hidden channels."""
        if not self.hidden:
            return signals
        room = [(0, 0)] * (signals.ndim - 1) + [(0, self.hidden)]
        return jnp.pad(signals, room)

    def hold_inputs(
        self,
        values: Float[Array, "*rows columns"],
        signal: Int[np.ndarray, " columns"] | None = None,
    ) -> Float[Array, "*rows columns"]:
        """Signals as the network sees them: inputs in their trained range, unless they
        are but flagged.

        `signal` tells which signals the columns are, by default all in order; physical
        units. The slope by an input is one up to and at the edge, and zero beyond; it
        is zero for an input that was constant in training.
        """
        if self.plain:
            return values
        at = np.arange(values.shape[-1]) if signal is None else signal
        given, lead = at < len(self.channels.inputs), (1,) * (values.ndim - 1)
        low = jnp.where(given, self.low[at], -jnp.inf).reshape(*lead, -1)
        high = jnp.where(given, self.high[at], jnp.inf).reshape(*lead, -1)
        # Not jnp.clip, whose slope at the edge is 1/2.
        beyond = (values < low) | (low == high)
        return jnp.where(beyond, low, jnp.where(values > high, high, values))

    within = old_method("within", "hold_inputs")

    def columns(
        self,
        signals: Float[Array, "time signals"],
        valid: Bool[Array, "time signals"] | None = None,
    ) -> tuple[Float[Array, "vars time"], tuple[Float[Array, "_ time"], ...]]:
        """Lagged variables of one record, known before the run, at every sample.

        The scaled ones of the terms behind a leading one, and per output those of the
        scheduling in physical units, of inputs held to their ranges. A network
        that goes on to first order (`outside`) has another row for every variable
        behind them: how far it is beyond what is held. Filters
        begin at rest at the first valid sample (without `valid`: the first); see
        `jaxnarx.regressors.record_columns`. Hidden channels are zeros.
        """
        given, signals = (
            self.complete(signals),
            self.complete(self.hold_inputs(signals)),
        )
        valid = None if valid is None else self.complete(valid)
        at = jnp.arange(signals.shape[0])
        ones = jnp.ones((1, at.shape[0]), signals.dtype)

        def table(values, variables):
            return record_columns(values, valid, at, variables, self.sample_time)

        scaled = [table(signals / self.gain[None], self.variables)]
        if self.outside == LINEAR:
            scaled.append(table((given - signals) / self.gain[None], self.variables))
        x = tuple(table(signals, m.scheduling) for m in self.models)
        return jnp.concatenate([ones, *scaled]), x

    def __call__(
        self, u: Float[Arrays, "time inputs"], start: Any = "zeros"
    ) -> Float[Array, "time outputs"]:
        """The free run of one record, plain arrays in physical units.

        Can be jitted, mapped and differentiated, by the network, `u` and `start`.
        Outputs are those that `jnx.simulate` reports; where its policy is to say
        nothing (NaN), these go on. Shapes that do not fit are a `SpecError`.

        Args:
            u: Inputs, one column each, then those of measured outputs that the network
                looks at and does not compute.
            start: Measured outputs (time, outputs), of which the first `history` rows
                are used, with hidden channels `before` rows: these are repeated at the
                start of the result, and hidden channels begin with what fits them best.
                Or a state (`init`, `step`), `"steady"`, at rest under the first inputs,
                or `"zeros"`, outputs that were zero and inputs that were the first.
                Whether a state of rest was found `StateForm.equilibrium` tells; where
                none is, the run begins where the search for it ended.

        Example:
            y = network(u, y_measured)
            slope = jax.jit(jax.grad(lambda u: network(u, "steady")[-1, 0]))(u)
        """
        from jaxnarx.models.state_form import run  # it is made of networks

        return run(self, u, start)

    def init(self, start: Any = "zeros", u: Any = None) -> Float[Array, " states"]:
        """The state of a run that goes on behind measured samples, see `step`.

        `start` are outputs (time, outputs) measured at the samples before, at least
        `before` of them for hidden channels, and `u` the inputs there; without `u` the
        middle of their trained ranges. Or `"steady"` or `"zeros"`, as in a call.
        """
        from jaxnarx.models.state_form import init  # it is made of networks

        return init(self, start, u)

    def step(
        self, state: Float[Arrays, " states"], u: Float[Arrays, " inputs"]
    ) -> tuple[Float[Array, " states"], Float[Array, " outputs"]]:
        """The next state and the outputs at one sample of its inputs.

        The two functions of the state-space form, see `jnx.state_space`.

        Example:
            state = network.init("steady", u[0])
            state, y = network.step(state, u[0])
            step = lambda state, row: network.step(state, row)
            state, ys = jax.lax.scan(step, state, u)
        """
        from jaxnarx.models.state_form import step  # it is made of networks

        return step(self, state, u)

    def equations(self, *, style: str = "text") -> list[dict]:
        """Every local model's equation in physical units, host only.

        One dictionary per output and region: `output`, `model` (count from 1), `region`
        (where it is valid in physical units, by scheduling variable: `centre` and
        `width`, or `above` and `below`), `feedback` (`"own"` where the model is fed
        back the output of its own group, `NOx_2` for the second of NOx, else
        `"network"`), `floor` where its group computes r of NOx_2 = floor + r |r|,
        `terms` (text and coefficient) and the whole as `text` or `latex`.
        """
        return [
            self._equation(o, m, style)
            for o, model in enumerate(self.models)
            for m in np.flatnonzero(np.asarray(model.active)).tolist()
        ]

    def _equation(self, o: int, m: int, style: str, most: int | None = None) -> dict:
        local = self.models[o].local
        slots = np.flatnonzero(np.asarray(local.used)[m])[:most]
        factor = np.asarray(local.factor)[np.asarray(local.index)[m, slots]]
        signal = [s for s, _ in self.variables]
        scale = np.concatenate([[1.0], np.asarray(self.gain)[signal]])
        value = np.asarray(local.coefficient)[m, slots]
        unit = float(np.asarray(self.gain)[self.signals[o]])
        floor = self._floor(o, m)
        if floor is not None:  # own lags are roots too
            unit = math.sqrt(unit)
            scale[1:][np.array(signal) == self.signals[o]] = unit
        # Of channels of extreme units it may be beyond every number: inf then, or zero.
        with np.errstate(all="ignore"):
            value = value / np.prod(scale[factor], axis=1)
            value = value * unit
        output, names = self.computed_names[o], self.variable_names
        own = self.models[o].own
        groups = [] if own is None else np.flatnonzero(np.asarray(own)[:, m]).tolist()
        left = output
        if groups:
            left = f"{output}_{groups[0] + 1}"
            names = [
                name.replace(output, left, 1) if s == self.signals[o] else name
                for name, s in zip(names, signal, strict=True)
            ]
        return {
            "output": output,
            "model": int(m) + 1,
            "feedback": "own" if groups else "network",
            **({} if floor is None else {"floor": floor}),
            "region": self.regions(o)[int(m)],
            "terms": [
                (term_name(names, row), float(c))
                for row, c in zip(factor.tolist(), value, strict=True)
            ],
            style: equation(left, names, factor.tolist(), value, style=style),
        }

    def _floor(self, o: int, m: int) -> float | None:
        """The floor, physical, below a local model's root; None where it has none."""
        model = self.models[o]
        if model.root is None or model.own is None:
            return None
        squares = np.asarray(model.root.squares)[:, None] & np.asarray(model.own)
        groups = np.flatnonzero(squares[:, m])
        if not len(groups):
            return None
        gain = float(np.asarray(self.gain)[self.signals[o]])
        return gain * float(np.asarray(model.root.floor)[groups[0]])

    def regions(self, output: int | str) -> list[dict[str, dict[str, float]]]:
        """The regions of one output's or hidden channel's (its number or name) local
        models, in physical units."""
        names = self.computed_names
        number = names.index(output) if output in names else output
        if number not in range(len(names)):
            raise SpecError(
                f"there is no modelled output {output!r}; there are "
                + ", ".join(f"{name} ({o})" for o, name in enumerate(names)),
                field="output",
            )
        model = self.models[int(number)]
        names = variable_names(self.channels, model.scheduling)
        span, offset = np.asarray(model.span), np.asarray(model.offset)
        return model.validity.regions(names, offset, span)


def _describe_region(region: dict[str, dict[str, float]]) -> str:
    """` (speed[t] near 900, load[t] above 3)`."""
    words = {"centre": "near", "above": "above", "below": "below"}
    parts = [
        f"{name} {words[key]} {value:.4g}"
        for name, bounds in region.items()
        for key, value in bounds.items()
        if key in words
    ]
    return f" ({', '.join(parts)})" if parts else ""
