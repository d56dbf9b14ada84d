"""Functions of CasADi: the model's runs, and its slopes, to the last digits."""

import jax
import numpy as np
import pytest
import test_dcm
import test_targets

import jaxnarx as jnx
from jaxnarx.exporters import ExportError, export, lower, make_cases
from jaxnarx.exporters._casadi import casadi_files, prove_casadi
from jaxnarx.exporters.proof import make_steps
from jaxnarx.exporters.runners import import_page
from jaxnarx.exporters.state_program import without_gaps

ca = pytest.importorskip("casadi")
STEPS = 6


def module_of(net, folder):
    """The functions that are written for a network."""
    (folder / "m_casadi.py").write_text(page_of(net))
    return import_page(folder / "m_casadi.py")


def page_of(net) -> str:
    text = casadi_files(lower(net, "m"), {})["m_casadi.py"]
    assert isinstance(text, str)
    return text


@pytest.mark.parametrize("name", ["SigmoidTree", "groups", "hidden"])
def test_it_runs_as_the_network_does(name):
    net = test_targets.NETWORKS[name]()
    found = export(net, to=["casadi"], name="m")
    assert not found.left_out and found.difference["casadi"] < 1e-12


@pytest.mark.parametrize("name", ["coupled", "filters"])
def test_outputs_move_with_inputs_as_those_of_the_state_space_form(name, tmp_path):
    net = test_targets.NETWORKS[name]()
    form, module = jnx.state_space(net), module_of(net, tmp_path)
    assert module.INPUTS == form.inputs and module.OUTPUTS == form.outputs
    middle = 0.5 * (np.array(module.LOW) + np.array(module.HIGH))
    u = np.tile(middle, (STEPS, 1))
    x, settled = form.equilibrium(middle)
    assert settled
    rest = np.asarray(form.h(x, middle))

    def outputs(u):
        return jax.lax.scan(lambda x, row: net.step(x, row), x, u)[1]

    slopes = np.asarray(jax.jacfwd(outputs)(jax.device_put(u)))
    inputs = ca.SX.sym("u", u.shape[1], STEPS)
    state, rows = module.begin(middle, rest), []
    for k in range(STEPS):
        state, y = module.step(state, inputs[:, k])
        rows.append(y)
    made = ca.jacobian(ca.vertcat(*rows), ca.vec(inputs))
    found = ca.Function("j", [inputs], [made])(u.T).full()
    found = found.reshape(STEPS, len(rest), STEPS, -1)
    size = np.abs(slopes).max()
    np.testing.assert_allclose(found, slopes, rtol=0, atol=1e-11 * size)


def test_what_is_kept_for_missing_inputs_is_left_out():
    program = lower(test_dcm.rising(), "m")
    bare = without_gaps(program)
    assert [s.name for s in program.states] == ["held_0", "held_1", "gap"]
    assert not bare.states and len(bare.delays) == 3
    assert len(bare.step) < len(program.step) - 20 and not bare.flags


def test_acados_can_take_its_expressions(tmp_path):
    module = module_of(test_dcm.rising(), tmp_path)
    x, u = (ca.SX.sym(n, len(s)) for n, s in (("x", module.STATES), ("u", module.LOW)))
    after = module.f(x, u)
    assert after.shape == x.shape and isinstance(after, ca.SX)
    hessian = ca.hessian(ca.sumsqr(after), ca.vertcat(x, u))[0]
    assert np.all(np.isfinite(ca.Function("h", [x, u], [hessian])(0.1, 0.2).full()))


def test_one_that_does_something_else_is_found_out(tmp_path):
    net = test_targets.NETWORKS["bounded"]()
    wrong = page_of(net).replace("ca.fmin", "ca.fmax")
    (tmp_path / "m_casadi.py").write_text(wrong)
    program = lower(net, "m")
    with pytest.raises(ExportError, match="CasADi"):
        prove_casadi(program, tmp_path, make_cases(net, program, make_steps(net)))
