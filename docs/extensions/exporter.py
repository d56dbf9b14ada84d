"""An exporter: the operations of a sample as a table of comma separated values.

The proof reads the table and carries out what stands there, for every record.
"""

import csv
import io
import json

import numpy as np

from jaxnarx.exporters import DOUBLE_TOLERANCE, TARGETS, Instance, Target, worst


def write(program, golden) -> dict[str, str | bytes]:
    """A line for every operation: number, kind, arguments, source."""
    file = io.StringIO()
    lines = csv.writer(file, lineterminator="\n")
    lines.writerow(["value", "kind", "arguments", "source"])
    for n, op in enumerate(program.ops):
        source = json.dumps(op.source)
        lines.writerow([n, op.kind, " ".join(map(str, op.args)), source])
    return {f"{program.name}_operations.csv": file.getvalue()}


def prove(program, folder, cases):
    """Run what the file says; ExportError where it differs from the model."""
    text = (folder / f"{program.name}_operations.csv").read_text("utf-8")
    ops = [
        type(op)(row["kind"], tuple(map(int, row["arguments"].split())), _source(row))
        for op, row in zip(program.ops, csv.DictReader(io.StringIO(text)), strict=True)
    ]
    told = type(program)(**{**vars(program), "ops": tuple(ops)})

    def run(inputs, measured):
        instance = Instance(told)
        instance.begin(inputs[0], measured[0])
        for u, y in zip(inputs[: told.history], measured, strict=False):
            instance.observe(u, y)
        return np.array([instance.step(u)["outputs"] for u in inputs[told.history :]])

    return {"table": worst(cases, run, DOUBLE_TOLERANCE, "table")}, []


def _source(row):
    source = json.loads(row["source"])
    return tuple(source) if isinstance(source, list) else source


TARGETS.register("table", Target("operations as a table", write, prove))
