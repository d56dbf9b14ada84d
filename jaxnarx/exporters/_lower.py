"""A network as a program: what one sample of its free run takes.

Inputs and measured outputs are cleaned once, where they enter
(`jaxnarx.exporters.entrance`), by the rule of `jaxnarx.models.missing`: every target
has it from here.
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from jaxnarx.errors import SpecError
from jaxnarx.exporters.confidence import domain_index, half_width
from jaxnarx.exporters.derivatives import gradient
from jaxnarx.exporters.entrance import Entrance
from jaxnarx.exporters.form import (
    BLEND,
    FILTERS,
    FRAME,
    HALF_FLAG_PREFIX,
    INDEX_FLAG,
    TERMS,
    WEIGHTS,
    Builder,
    DelayLine,
    LearntOutput,
    Port,
    SampleProgram,
    StateValue,
    Value,
)
from jaxnarx.exporters.limits import limited_outputs
from jaxnarx.exporters.names import identifier, identifiers
from jaxnarx.exporters.notes import policy_notes
from jaxnarx.exporters.parameters import (
    THETA_TABLE,
    OutputAt,
    column_names,
    has_regions,
    tables_at,
)
from jaxnarx.exporters.validities import Tables, weights
from jaxnarx.models import LARGEST_INDEX, LINEAR, Network, OutputModel
from jaxnarx.regressors import AbstractFilter, Variables, realise


def lower(
    network: Network,
    name: str = "model",
    *,
    index: bool = True,
    level: float | None = None,
    slopes: bool = True,
    learnable: bool = False,
) -> SampleProgram:
    """The program of a network.

    If the network has a domain and `index` is set, the flags include the domain index;
    with an error model and a `level`, `half_` and an output's name: half of its
    prediction interval of that probability. `SpecError` where it has a validity
    function that is not known here, or is asked for intervals without an error model.
    Without `slopes` the program has no `jacobian`; if it is `learnable`, it has
    `regressions`.
    """
    known = network.domain is not None
    if level is not None and (network.errors is None or not known):
        raise SpecError(
            "the network has no error model, so it has no intervals to export: "
            "jnx.confidence.fit_error_model(network, data) fits one",
            field="level",
        )
    lowering = _Lowering(network, name)
    program = lowering.program(index=index and known, level=level, slopes=slopes)
    if not learnable:
        return program
    found = lowering.regressions()  # its operations join those of the program
    ops = tuple(lowering.b.ops)
    return dataclasses.replace(program, ops=ops, regressions=found)


@dataclasses.dataclass
class _Line:
    """A delay line that is being made."""

    source: Value | None = None
    start: Value = 0
    measured: Value = 0
    length: int = 0


class _LoweredModels(NamedTuple):
    """Local models of an output: entries in its table of coefficients and the terms
    they multiply, weights and what these are divided by, and the output by them."""

    entries: list[tuple[int, ...]]
    terms: list[tuple[Value, ...]]
    weights: list[Value]
    total: Value | None
    value: Value


class _Lowering:
    def __init__(self, network: Network, name: str) -> None:
        self.network, self.name = network, name
        self.b = Builder()
        self.lines: dict[str, _Line] = {}
        self.states: dict[str, StateValue] = {}
        self.rest: dict[Value, Value] = {}
        self.cascades: dict[tuple, str] = {}
        self.local: list[_LoweredModels] = []
        self.gain = np.asarray(network.gain, float)
        self.low, self.high = (
            np.asarray(a, float) for a in (network.low, network.high)
        )
        self.given = len(network.channels.inputs)
        self.inputs = [
            *range(self.given),
            *(s for s in network.used if s >= self.given),
        ]
        self.entrance = Entrance(self.b, network, self.inputs)
        self.names = identifiers(network.computed_names)

    def _all_tables(self) -> list[Variables]:
        return [self.network.variables, *(m.scheduling for m in self.network.models)]

    def program(
        self, *, index: bool, level: float | None, slopes: bool
    ) -> SampleProgram:
        network, b = self.network, self.b
        for o in range(len(network.models)):
            self.lines[f"y_{self.names[o]}"] = self._measured_line(o, self.names[o])
        fed: list[Value] = []
        limited: list[Value] = []
        for o, model in enumerate(network.models):
            value = self._output(o, model)
            bounded, beyond = self._bound_output(o, value)
            fed.append(bounded)
            limited.append(beyond)
            self.lines[f"y_{self.names[o]}"].source = bounded
        own = np.asarray(network.signals)
        physical = [
            b.mul(y, b.const(float(self.gain[s])))
            for y, s in zip(fed, own, strict=True)
        ]
        limited = self._limit_flags(limited)
        flags = {"extrapolated": self._extrapolation_flag()}
        reported = physical[: len(network.modelled)]
        outputs, kept = limited_outputs(b, network, self.entrance, reported, flags)
        self.states |= kept
        ports = self._ports(network.computed, own)
        past = [
            (f"y_{name}", k + 1)
            for name in self.names
            for k in range(self.lines[f"y_{name}"].length)
        ]
        sources = [
            *(b.op("input", source=i) for i in range(len(self.inputs))),
            *(b.op("delay", source=one) for one in past),
        ]
        jacobian = [gradient(b, y, sources) for y in physical if slopes]
        if index or level is not None:
            flags |= self._confidence(physical, index=index, level=level)
        flags |= self.entrance.flags()
        first = self.entrance.first
        lines = [
            DelayLine(
                name,
                line.length,
                line.source,
                b.substitute(line.start, first),
                line.measured,
            )
            for name, line in self.lines.items()
            if line.length and line.source is not None
        ]
        states = [
            dataclasses.replace(s, start=b.substitute(s.start, first))
            for s in (*self.states.values(), *self.entrance.states())
        ]
        channels = (*network.channels.inputs, *network.channels.outputs)
        return SampleProgram(
            name=identifier(self.name),
            sample_time=float(network.sample_time),
            history=network.history,
            inputs=self._ports([channels[s] for s in self.inputs], self.inputs),
            reported=ports[: len(network.modelled)],
            computed=ports,
            ops=tuple(b.ops),
            tables=tuple(b.tables.values()),
            delays=tuple(lines),
            states=tuple(states),
            outputs=tuple(outputs),
            jacobian=tuple(jacobian),
            past=tuple(past),
            fed=tuple(physical),
            limited=tuple(limited),
            flags=flags,
            notes=policy_notes(network, flags),
        )

    def _ports(self, channels: Any, signals: Any) -> tuple[Port, ...]:
        return tuple(
            Port(c.name, c.unit or "", float(self.low[s]), float(self.high[s]))
            for c, s in zip(channels, signals, strict=True)
        )

    # inputs ------------------------------------------------------------------------

    def _raw(self, signal: int) -> Value:
        """A signal as it is, held where it is missing."""
        return self.entrance.signal(signal)

    def _held_signal(self, signal: int) -> Value:
        """A signal as the network sees it, physical."""
        raw = self._raw(signal)
        if self.network.plain or signal >= self.given:
            return raw
        b = self.b
        low, high = b.const(self.low[signal]), b.const(self.high[signal])
        if self.low[signal] == self.high[signal]:
            return low
        # No clip, whose slope at the edge is zero: a command that stands there would
        # seem to be without effect.
        below, above = b.op("less", raw, low), b.op("less", high, raw)
        return b.op("where", below, low, b.op("where", above, high, raw))

    def _scale_signal(self, signal: int, *, far: bool) -> Value:
        """Return a signal divided by its gain; `far`: how far it is beyond what is
        held."""
        b, seen = self.b, self._held_signal(signal)
        value = b.op("sub", self._raw(signal), seen) if far else seen
        return b.mul(value, b.const(1 / self.gain[signal]))

    def _variable(
        self, signal: int, lag: int, filter_: AbstractFilter | None, *, far=False
    ) -> Value:
        """A lagged variable, scaled; of what is computed from what is fed back."""
        if signal in self.network.signals:
            if far:
                return self.b.const(0.0)
            return self._delay_output(self.network.signals.index(signal), lag)
        if far and signal >= self.given:
            return self.b.const(0.0)
        with self.b.purpose(FRAME):
            value = self._scale_signal(signal, far=far)
        base = self._base("far" if far else "u", signal)
        if filter_ is not None:
            with self.b.purpose(FILTERS):
                value, base = self._filter(value, base, filter_)
        return value if lag == 0 else self._delay(base, lag, value)

    def _base(self, kind: str, signal: int) -> str:
        """The name of what is kept of a signal."""
        channels = (*self.network.channels.inputs, *self.network.channels.outputs)
        return f"{kind}_{identifier(channels[signal].name)[:24]}_{signal}"

    def _delay(self, name: str, lag: int, value: Value) -> Value:
        start = self.rest.get(value, value)
        line = self.lines.setdefault(name, _Line(value, start, value))
        line.length = max(line.length, lag)
        return self.b.op("delay", source=(name, lag))

    def _filter(
        self, value: Value, base: str, filter_: AbstractFilter
    ) -> tuple[Value, str]:
        """A signal through a filter: cascades that begin alike share their states."""
        b, sections = self.b, filter_.sections
        system = realise(filter_, float(self.network.sample_time))
        a, gain, c, rest = (
            np.asarray(x, float) for x in (system.a, system.b, system.c, system.rest)
        )
        count = 2 * len(sections)
        names, after, at_rest = [], [], []
        for k in range(count):
            key = base, sections[: k // 2 + 1], k % 2
            names.append(self.cascades.setdefault(key, f"{base}_f{len(self.cascades)}"))
        known = [
            b.op("state", source=name) if np.any(a[:, k]) else None
            for k, name in enumerate(names)
        ]
        for k, name in enumerate(names):
            parts = [
                b.mul(b.const(a[k, j]), held)
                for j, held in enumerate(known)
                if a[k, j] != 0 and held is not None
            ]
            entering = [b.mul(b.const(gain[k]), value)] if gain[k] else []
            now = b.add(*parts, *entering)
            after.append(now)
            at_rest.append(b.mul(b.const(rest[k]), value))
            if known[k] is not None:
                self.states.setdefault(name, StateValue(name, now, at_rest[k]))
        out = b.add(
            *(b.mul(b.const(c[k]), after[k]) for k in range(count) if c[k] != 0)
        )
        self.rest[out] = b.mul(b.const(float(c @ rest)), value)
        (place,) = np.flatnonzero(c)
        return out, f"{names[int(place)]}{'u' if filter_.unit_gain else 'n'}"

    # feedback ----------------------------------------------------------------------

    def _measured_line(self, o: int, name: str, group: int | None = None) -> _Line:
        """A delay line `y_` of a name that the measured output o begins; of a group
        that computes a root, the root: that of a rounded output has larger errors."""
        b, scale = self.b, self.b.const(1 / self.gain[self.network.signals[o]])
        line = f"y_{name}"
        start = b.mul(self.entrance.measured_output(o), scale)
        before, now = b.op("delay", source=(line, 1)), b.op("measured", source=o)
        now = b.mul(now, scale)
        if group is not None and self._squares(o, group):
            start, now = (self._to_root(o, group, y) for y in (start, now))
        measured = self.entrance.measured_output(o, now, before)
        return _Line(None, start, measured)

    def _delay_output(self, o: int, lag: int, group: int | None = None) -> Value:
        name = f"y_{self.names[o]}" + ("" if group is None else f"_group{group + 1}")
        line = self.lines[name]
        line.length = max(line.length, lag)
        return self.b.op("delay", source=(name, lag))

    def _bound_output(
        self, o: int, value: Value, group: int | None = None
    ) -> tuple[Value, Value]:
        """A value within the bounds of an output, or of what a group computes, and
        whether they act."""
        b, network = self.b, self.network
        low, high = (
            b.const(float(np.asarray(a)[o])) for a in (network.lower, network.upper)
        )
        if group is not None and self._squares(o, group):
            low, high = (self._to_root(o, group, end) for end in (low, high))
        inside = b.op("min", b.op("less", low, value), b.op("less", value, high))
        return b.clip(value, low, high), b.no(inside)

    def _limit_flags(self, acted: list[Value]) -> list[Value]:
        """Flags of the bound on an output or on any hidden channel that does not
        saturate, for it enters all outputs; then of every hidden channel alone."""
        count = len(self.network.modelled)
        free = np.flatnonzero(~np.asarray(self.network.saturates)[count:])
        hidden = [acted[count + n] for n in free]
        return [self.b.largest([one, *hidden]) for one in acted[:count]] + acted[count:]

    # local models ------------------------------------------------------------------

    def _output(self, o: int, model: OutputModel) -> Value:
        b, name, at = self.b, self.names[o], OutputAt(self.network, o)
        active, known = at.active, tables_at(at)

        def tables(kind: str) -> np.ndarray:
            values, about = known[kind].read(at), known[kind].about
            columns = column_names(at, kind, values)
            return b.parameters(f"{kind}_{name}", values, about, columns=columns)

        with b.purpose(WEIGHTS):
            z = self._scheduling_values(model, tables) if has_regions(at) else []
            phi, total = weights(b, at, z, tables)
        factor = np.asarray(model.local.factor)
        dense, used, table = (
            THETA_TABLE.read(at),
            THETA_TABLE.columns(at),
            tables("theta"),
        )
        group_of: dict[int, int] = {}
        own = None if model.own is None else np.asarray(model.own)[:, active]
        if own is not None:
            groups, members = np.nonzero(own)
            group_of = dict(zip(members.tolist(), groups.tolist(), strict=True))
            for g in range(len(own)):
                group = f"{name}_group{g + 1}"
                self.lines[f"y_{group}"] = self._measured_line(o, group, g)
        local: list[Value] = []
        entries: list[tuple[int, ...]] = []
        terms: list[tuple[Value, ...]] = []
        with b.purpose(TERMS):
            for m in range(len(active)):
                own_columns = np.flatnonzero(dense[m]).tolist()
                entries.append(tuple(m * len(used) + k for k in own_columns))
                terms.append(
                    tuple(
                        self._term(factor[used[k]], o, group_of.get(m))
                        for k in own_columns
                    )
                )
                parts = map(b.mul, table[m, own_columns], terms[m])
                local.append(b.add(*parts))
        squared: list[tuple[Value, Value]] = []
        inside: set[int] = set()
        if own is not None:
            for g, row in enumerate(own):
                members = np.flatnonzero(row).tolist()
                # Of a group whose models are all switched off nothing depends.
                value = self._group(members, phi, local) if members else b.const(0.0)
                bounded, _ = self._bound_output(o, value, g)
                self.lines[f"y_{name}_group{g + 1}"].source = bounded
                if self._squares(o, g):
                    inside |= set(members)
                    share = b.add(*(phi[m] for m in members))
                    value = self._to_output(o, g, value)
                    squared.append((share, value))
        with b.purpose(BLEND):
            plain = [
                p for m, p in enumerate(zip(phi, local, strict=True)) if m not in inside
            ]
            blend = b.add(*(b.mul(*pair) for pair in (*plain, *squared)))
            value = blend if total is None else b.op("div", blend, total)
        self.local.append(_LoweredModels(entries, terms, phi, total, value))
        return value

    def regressions(self) -> tuple[LearntOutput, ...]:
        """What the coefficients of every output are learnt from."""
        b, network, found = self.b, self.network, []
        low, high = (np.asarray(a, float) for a in (network.lower, network.upper))
        for o, one in enumerate(self.local):
            shares = one.weights
            if one.total is not None:
                shares = [b.op("div", w, one.total) for w in shares]
            gain = float(self.gain[network.signals[o]])
            scaled = b.mul(b.op("measured", source=o), b.const(1 / gain))
            zero = b.const(0.0)
            found.append(
                LearntOutput(
                    f"theta_{self.names[o]}",
                    tuple(one.entries),
                    tuple(one.terms),
                    tuple(shares),
                    one.value,
                    float(low[o]),
                    float(high[o]),
                    gain,
                    self.entrance.measured_output(o, scaled, zero),
                    self.entrance.measured_output(o, b.const(1.0), zero),
                )
            )
        return tuple(found)

    def _squares(self, o: int, group: int) -> bool:
        """Whether a group computes a root of its output."""
        root = self.network.models[o].root
        return root is not None and bool(np.asarray(root.squares)[group])

    def _to_output(self, o: int, group: int, r: Value) -> Value:
        """floor + r |r|."""
        b, root = self.b, self.network.models[o].root
        assert root is not None
        with b.purpose(BLEND):
            floor = b.const(float(np.asarray(root.floor)[group]))
            return b.add(b.mul(r, b.size(r, 1.0)), floor)

    def _to_root(self, o: int, group: int, y: Value) -> Value:
        """The inverse, as `SignedRoot.to_root`."""
        b, root = self.b, self.network.models[o].root
        assert root is not None
        with b.purpose(FRAME):
            far = b.op("sub", y, b.const(float(np.asarray(root.floor)[group])))
            size = b.op("sqrt", b.size(far, 1.0))
            above = b.op("less", b.const(0.0), far)
            return b.op("where", above, size, b.op("neg", size))

    def _group(self, members: list[int], phi: list[Value], local: list[Value]) -> Value:
        """Mean of a group by its weights; of all alike where they vanish."""
        if len(members) == 1:
            return local[members[0]]
        with self.b.purpose(BLEND):
            return self._mean(members, phi, local)

    def _mean(self, members: list[int], phi: list[Value], local: list[Value]) -> Value:
        b = self.b
        total = b.add(*(phi[m] for m in members))
        there = b.op("less", b.const(0.0), total)
        safe = b.op("where", there, total, b.const(1.0))
        weighted = b.add(*(b.mul(phi[m], local[m]) for m in members))
        plain = b.add(*(local[m] for m in members))
        return b.op(
            "where",
            there,
            b.op("div", weighted, safe),
            b.mul(plain, b.const(1 / len(members))),
        )

    def _term(self, row: np.ndarray, o: int, group: int | None) -> Value:
        """A product of variables; with inputs beyond their ranges, and no feedback in
        it, on from the edge to first order."""
        b, entries = self.b, self.network.variables.entries
        chosen = [entries[n - 1] for n in row.tolist() if n > 0]
        values = [
            self._delay_output(o, lag, group)
            if group is not None and signal == self.network.signals[o]
            else self._variable(signal, lag, filter_)
            for signal, lag, filter_ in chosen
        ]
        product = b.mul(*values) if values else b.const(1.0)
        fed = any(signal in self.network.signals for signal, *_ in chosen)
        if self.network.outside != LINEAR or fed or not chosen:
            return product
        beyond = [
            b.mul(
                self._variable(*entry, far=True),
                *(v for k, v in enumerate(values) if k != j),
            )
            for j, entry in enumerate(chosen)
        ]
        return b.add(product, *beyond)

    def _scheduling_values(self, model: OutputModel, tables: Tables) -> list[Value]:
        b, (factor, subtracted) = self.b, tables("scheduling")
        values = [self._variable(*entry) for entry in model.scheduling.entries]
        return [
            b.op("sub", b.mul(value, scale), away)
            for value, scale, away in zip(values, factor, subtracted, strict=True)
        ]

    # limits ------------------------------------------------------------------------

    def _extrapolation_flag(self) -> Value:
        """The flag of a signal in a term or in the scheduling that leaves its range, or
        is missing."""
        b, found = self.b, []
        rows = dict.fromkeys(row for table in self._all_tables() for row in table)
        for s, lag in rows:
            if s in self.network.signals:
                continue
            raw, slack = self._raw(s), 1e-9 * (self.high[s] - self.low[s])
            below = b.op("less", raw, b.const(self.low[s] - slack))
            above = b.op("less", b.const(self.high[s] + slack), raw)
            out = b.op("max", below, above)
            if lag:
                line = _Line(out, b.const(0.0), out)
                line = self.lines.setdefault(f"out_{s}", line)
                line.length = max(line.length, lag)
                out = b.op("delay", source=(f"out_{s}", lag))
            found.append(out)
        gap = [self.entrance.missing] if self.network.used else []
        return b.largest([*found, *gap]) if found else b.const(0.0)

    def _confidence(
        self, physical: list[Value], *, index: bool, level: float | None
    ) -> dict[str, Value]:
        """The index of the domain, and half widths of intervals."""
        b, domain, errors = self.b, self.network.domain, self.network.errors
        assert domain is not None
        x = [self._feature(*entry) for entry in domain.features.entries]
        raw = [self._raw(s) for s in domain.inputs]
        step = [
            b.op("sub", now, self._delay(self._base("in", s), 1, now))
            for s, now in zip(domain.inputs, raw, strict=True)
        ]
        far = domain_index(b, domain, x, step)
        far = b.op("where", self.entrance.missing, b.const(LARGEST_INDEX), far)
        flags = {INDEX_FLAG: far} if index else {}
        if level is None or errors is None:
            return flags
        used = len(x) // 2
        apart = [
            b.size(b.op("sub", now, slow), 1.0)
            for now, slow in zip(x[:used], x[used:], strict=True)
        ]
        for o in range(len(self.network.modelled)):
            before = b.mul(
                self._delay_output(o, 1),
                b.const(float(self.gain[self.network.signals[o]])),
            )
            moved = b.size(b.op("sub", physical[o], before), 1.0)
            z = [*x, *apart, physical[o], moved, far]
            name = self.names[o]
            flags[f"{HALF_FLAG_PREFIX}{name}"] = half_width(
                b, errors, o, level, z, name
            )
        return flags

    def _feature(self, signal: int, lag: int, filter_: AbstractFilter | None) -> Value:
        """An input as it is, physical, and through a filter."""
        raw, base = self._raw(signal), self._base("in", signal)
        if filter_ is not None:
            raw, base = self._filter(raw, base, filter_)
        return raw if lag == 0 else self._delay(base, lag, raw)
