"""Exact slopes of a value by sources, as further operations (reverse accumulation)."""

from collections.abc import Sequence

from jaxnarx.exporters.form import Builder, Value


def gradient(b: Builder, value: Value, sources: Sequence[Value]) -> tuple[Value, ...]:
    """d value / d source for every source.

    Bounds have slope one inside and zero at and beyond them, as in `simulate`'s
    derivatives; comparisons have none.
    """
    adjoint: dict[Value, Value] = {value: b.const(1.0)}

    def give(to: Value, slope: Value) -> None:
        adjoint[to] = b.add(adjoint[to], slope) if to in adjoint else slope

    reached = {value}
    for n in range(value, -1, -1):
        if n not in reached or n not in adjoint:
            continue
        op, a = b.ops[n], adjoint[n]
        reached.update(op.args)
        match op.kind:
            case "add":
                give(op.args[0], a)
                give(op.args[1], a)
            case "sub":
                give(op.args[0], a)
                give(op.args[1], b.op("neg", a))
            case "neg":
                give(op.args[0], b.op("neg", a))
            case "mul":
                give(op.args[0], b.mul(a, op.args[1]))
                give(op.args[1], b.mul(a, op.args[0]))
            case "div":
                slope = b.op("div", a, op.args[1])
                give(op.args[0], slope)
                give(op.args[1], b.op("neg", b.mul(slope, n)))
            case "exp":
                give(op.args[0], b.mul(a, n))
            case "sqrt":
                give(op.args[0], b.op("div", a, b.add(n, n)))
            case "max" | "min":
                x, y = op.args
                first = b.op("less", y, x) if op.kind == "max" else b.op("less", x, y)
                zero = b.const(0.0)
                give(x, b.op("where", first, a, zero))
                give(y, b.op("where", first, zero, a))
            case "where":
                zero = b.const(0.0)
                give(op.args[1], b.op("where", op.args[0], a, zero))
                give(op.args[2], b.op("where", op.args[0], zero, a))
    zero = b.const(0.0)
    return tuple(adjoint.get(source, zero) for source in sources)
