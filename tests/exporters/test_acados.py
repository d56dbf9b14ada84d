"""C for acados: runs, slopes and curvature to the last digits beside CasADi's."""

import shutil
import subprocess

import common
import numpy as np
import pytest
import test_targets
from common import some

import jaxnarx as jnx
from jaxnarx.exporters import ExportError, export, lower, make_cases
from jaxnarx.exporters._acados import AcadosLibrary, acados_files, prove_acados
from jaxnarx.exporters._casadi import casadi_files
from jaxnarx.exporters.proof import make_steps
from jaxnarx.exporters.runners import compiler, import_page
from jaxnarx.exporters.state_program import without_gaps

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
KINDS = [n for n in test_targets.NETWORKS if n != "bounded"]


def library_of(net, folder) -> AcadosLibrary:
    program = lower(net, "m")
    text = acados_files(program, {})["m_acados.c"]
    (folder / "m_acados.c").write_text(str(text))
    return AcadosLibrary(folder, without_gaps(program))


@pytest.mark.parametrize("name", some(KINDS, "SigmoidTree", "groups", "hidden"))
def test_it_runs_as_the_network_does(name):
    found = export(test_targets.NETWORKS[name](), to=["acados"], name="m")
    assert not found.left_out and found.difference["acados"] < 1e-11


def test_a_network_without_a_past_has_no_state():
    data = common.dataset()
    pool = jnx.polynomial_pool(
        data.channels, outputs=["y"], input_lags=(0,), output_lags=(), degree=2
    )
    net = jnx.grow(pool, data, jnx.Global()).value
    assert export(net, to=["acados"]).difference["acados"] < 1e-11


@pytest.mark.parametrize("name", some(KINDS, "filters", "coupled"))
def test_jacobian_and_hessian_are_those_of_casadi(name, tmp_path):
    ca = pytest.importorskip("casadi")
    net = test_targets.NETWORKS[name]()
    library = library_of(net, tmp_path)
    (tmp_path / "m_casadi.py").write_text(
        str(casadi_files(lower(net, "m"), {})["m_casadi.py"])
    )
    module = import_page(tmp_path / "m_casadi.py")
    x, u = ca.SX.sym("x", len(module.STATES)), ca.SX.sym("u", len(module.INPUTS))
    lam, both = ca.SX.sym("lam", len(module.STATES)), ca.vertcat(u, x)
    after = module.f(x, u)
    adjoint = ca.jtimes(after, both, lam, True)
    parts = [after, ca.jacobian(after, both).T, ca.jacobian(adjoint, both)]
    expected = ca.Function("all", [x, u, lam], parts)
    out = module.h(x, u)
    slopes = ca.Function("out", [x, u], [out, ca.jacobian(out, both).T])
    random = np.random.default_rng(0)
    low, high = np.array(module.LOW), np.array(module.HIGH)
    for _ in range(3):
        at = random.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low))
        start = 0.3 * random.uniform(size=len(module.STATES))
        multiplier = random.normal(size=len(start))
        for suffix, function, given in (
            ("dyn_disc_phi_fun_jac_hess", expected, (start, at, multiplier)),
            ("out_fun_jac", slopes, (start, at)),
        ):
            made = library.call(suffix, *given)
            for one, wanted in zip(made, function(*given), strict=True):
                wanted = wanted.full()
                size = max(1.0, np.abs(wanted).max())
                np.testing.assert_allclose(one, wanted, rtol=0, atol=1e-12 * size)


def test_a_host_program_calls_what_acados_would(tmp_path):
    """The file is built by gcc with the functions that a solver of this name links."""
    net = test_targets.NETWORKS["SigmoidTree"]()
    library = library_of(net, tmp_path)
    wide = len(library.begin(np.zeros(8), np.zeros(8)))
    (tmp_path / "host.c").write_text(HOST.replace("WIDE", str(wide)))
    command = [str(shutil.which("gcc") or compiler()), "-O2", "-Wall", "-Werror"]
    command += ["m_acados.c", "host.c", "-lm", "-o", "host"]
    subprocess.run(command, check=True, cwd=tmp_path)
    told = subprocess.run(["./host"], cwd=tmp_path, capture_output=True, text=True)
    assert told.returncode == 0, told.stdout


HOST = """
#include <math.h>
#include <stddef.h>
int m_dyn_disc_phi_fun(const double **, double **, int *, double *, int);
int m_dyn_disc_phi_fun_jac(const double **, double **, int *, double *, int);
int m_dyn_disc_phi_fun_jac_n_in(void);
int m_dyn_disc_phi_fun_jac_n_out(void);
int m_dyn_disc_phi_fun_jac_work(int *, int *, int *, int *);
const int *m_dyn_disc_phi_fun_jac_sparsity_out(int);
void m_x_begin(const double *, const double *, double *);
int main(void)
{
    static double u[64], y[64], x[64], phi[64], again[64], jac[4096];
    const double *arg[3] = {x, u, NULL};
    double *res[2] = {phi, jac}, *one[1] = {again};
    int k, sizes[4];
    const int *shape = m_dyn_disc_phi_fun_jac_sparsity_out(1);
    m_x_begin(u, y, x);
    m_dyn_disc_phi_fun_jac_work(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
    if (m_dyn_disc_phi_fun_jac_n_in() != 3) return 1;
    if (m_dyn_disc_phi_fun_jac_n_out() != 2) return 2;
    if (sizes[0] != 3 || sizes[1] != 2 || sizes[2] != 0) return 3;
    if (shape[1] != WIDE || shape[2] != 1) return 4;
    if (m_dyn_disc_phi_fun_jac(arg, res, NULL, NULL, 0) != 0) return 5;
    if (m_dyn_disc_phi_fun(arg, one, NULL, NULL, 0) != 0) return 6;
    for (k = 0; k < WIDE; k++) if (fabs(phi[k] - again[k]) > 1e-14) return 7;
    res[1] = NULL;
    return m_dyn_disc_phi_fun_jac(arg, res, NULL, NULL, 0);
}
"""


def test_one_that_does_something_else_is_found_out(tmp_path):
    net = test_targets.NETWORKS["by inputs"]()
    program = lower(net, "m")
    text = str(acados_files(program, {})["m_acados.c"])
    (tmp_path / "m_acados.c").write_text(text.replace("m_theta_y[1]", "m_theta_y[0]"))
    with pytest.raises(ExportError, match="acados"):
        prove_acados(program, tmp_path, make_cases(net, program, make_steps(net)))


@pytest.mark.parametrize("outside", ["hold", "linear"])
def test_slopes_at_the_edge_are_those_of_the_network(outside, tmp_path):
    """Where a command stands that a bound holds: neither zero nor that of a range that
    grows when it is left."""
    net = test_targets.narrowed(test_targets.NETWORKS["filters"](), outside)
    library, form = library_of(net, tmp_path), jnx.state_space(net)
    low, high = (np.asarray(a)[:2] for a in (net.low, net.high))
    for u in (low, high, np.array([low[0], 0.5 * (low + high)[1]])):
        x, _ = form.equilibrium(u)
        d = np.asarray(form.jacobians(x, u)[3])
        y = np.asarray(form.h(x, u))
        found = library.call("out_fun_jac", library.begin(u, y), u)
        np.testing.assert_allclose(found[0].ravel(), y, rtol=1e-9)
        np.testing.assert_allclose(found[1][:2].T, d, rtol=1e-9, atol=1e-12)
