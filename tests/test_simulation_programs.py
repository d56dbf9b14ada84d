"""One program for many networks, and long records in blocks."""

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest

from jaxnarx.data.batch import stack_records
from jaxnarx.models import Network
from jaxnarx.simulation import make_drive, run, simulate


@pytest.mark.slow
def test_networks_of_one_capacity_compile_once():
    data = common.dataset()
    whole = common.named("by inputs", spare_models=5, spare_slots=2)
    drive = make_drive(whole, stack_records(data))
    anchor = jnp.asarray(np.arange(common.TIME) == whole.history)[None].repeat(
        len(data), 0
    )
    local = whole.models[0].local

    def member(n: int) -> Network:
        """One to eight active models, zero to seven used slots in each."""
        rng = np.random.default_rng(n)
        active = np.arange(8) < 1 + n % 8
        used = np.arange(local.used.shape[1]) < rng.integers(0, 8, size=8)[:, None]
        return eqx.tree_at(
            lambda net: (net.models[0].active, net.models[0].local.used),
            whole,
            (jnp.asarray(active), jnp.asarray(used)),
        )

    members = [member(n) for n in range(50)]
    outputs = []
    jax.clear_caches()
    count = common.compilations(
        lambda: outputs.extend(run(net, drive, anchor) for net in members)
    )
    assert count == 1
    assert len({float(jnp.sum(y)) for y in outputs}) > 40


def test_long_records_are_run_as_short_ones():
    # 2,500 samples are collapsed in five blocks, the last one not full.
    net = common.named("by inputs")
    rows = common.signals(2500)
    found = simulate(net, common.from_rows([rows]))
    plain = oracles.free_run(rows, common.to_oracle(net))
    # A stable recursion on values of order ten.
    np.testing.assert_allclose(found.value[0], plain.outputs, rtol=0, atol=1e-10)
