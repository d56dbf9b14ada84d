"""An inverse and the network behind it, exported apart, do what their cascade does."""

import inverse_problems as problems
import numpy as np
import pytest

from jaxnarx.exporters import Instance, lower
from jaxnarx.inverse import cascade, inverse_data

LEAD = 2


@pytest.mark.slow
def test_two_exports_in_a_row_are_the_cascade():
    data = problems.recorded(problems.plant, records=1)
    forward = problems.exact(data, lags=(2,), degree=2)
    back = inverse_data(data, commands=["u"], targets=["y"], lead=LEAD)
    inverse = problems.polynomial_inverse(back, degree=2)
    expected = cascade(inverse, forward, data).value
    ahead, plant = Instance(lower(inverse)), Instance(lower(forward))
    (record,) = data.records
    u, d, y = record.u[:, 0], record.u[:, 1], record.y[:, 0]
    assert [p.name for p in ahead.program.inputs] == [f"y_ahead{LEAD}", "d"]
    first = max(ahead.program.history, plant.program.history)
    commands, outputs = u.copy(), y.copy()
    ahead.begin(np.array([y[LEAD], d[0]]), u[:1])
    plant.begin(np.array([u[0], d[0]]), y[:1])
    for t in range(len(u) - LEAD):
        wanted = np.array([y[t + LEAD], d[t]])
        if t < first:
            ahead.observe(wanted, u[t : t + 1])
            plant.observe(np.array([u[t], d[t]]), y[t : t + 1])
            continue
        (commands[t],) = ahead.step(wanted)["outputs"]
        (outputs[t],) = plant.step(np.array([commands[t], d[t]]))["outputs"]
    scored = slice(first, len(u) - LEAD)
    for found, whole in ((commands, expected.commands), (outputs, expected.outputs)):
        np.testing.assert_allclose(
            found[scored], whole[0][scored, 0], rtol=1e-10, atol=1e-12
        )
