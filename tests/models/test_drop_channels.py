"""A network without outputs that it does not look at runs as before."""

import common
import numpy as np
import pytest
from common import A, B, Part, W

from jaxnarx.data import match_channels
from jaxnarx.models import drop_outputs
from jaxnarx.simulation import simulate

LAST = Part(
    [[((0, 1), 0.5), ((0, 3), 0.6)], [((0, 2), -0.4), ((1, 3), 0.3)]],
    scheduling=((W, 1),),
    offset=(-3.0,),
    span=(6.0,),
    centre=((0.3,), (0.7,)),
    width=((0.3,), (0.3,)),
)


@pytest.mark.parametrize("kept", ["y", "w"])
def test_the_free_run_stays_and_the_other_output_goes(kept):
    if kept == "y":
        network = common.named("by inputs")
    else:
        rows = ((A, 0), (B, 1), (W, 1))
        network = common.network([LAST], (1,), variables=rows)
    small = drop_outputs(network)
    assert small.channels.output_names == small.output_names == [kept]
    data = common.dataset()
    whole = simulate(network, data).value
    alone = simulate(small, match_channels(data, small.channels)[0]).value
    for a, b in zip(whole.outputs, alone.outputs, strict=True):
        np.testing.assert_array_equal(a, b)
    assert small.equations() == network.equations()


def test_an_output_that_is_looked_at_stays():
    by_other = common.network([common.PARTS["one"]], (1,))  # w from lags of y
    both = common.named("coupled")
    assert drop_outputs(by_other) is by_other and drop_outputs(both) is both
