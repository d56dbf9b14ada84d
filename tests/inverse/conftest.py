"""One plant, its exact forward network and one inverse for all tests of this folder."""

import pytest
from inverse_problems import exact, plant, polynomial_inverse, recorded

from jaxnarx.data import Dataset
from jaxnarx.inverse import inverse_data
from jaxnarx.models import Network


@pytest.fixture(scope="session")
def clean() -> Dataset:
    """Records of `plant` without noise."""
    return recorded(plant)


@pytest.fixture(scope="session")
def forward(clean) -> Network:
    """The plant as a network, exact to rounding."""
    return exact(clean, lags=(2,), degree=3, disturbance=2)


@pytest.fixture(scope="session")
def inverse(forward) -> Network:
    """A direct inverse that is too simple, from noisy records. It feeds its command
    back: the loop has memory that could wind up."""
    noisy = recorded(plant, noise=0.1)
    data = inverse_data(noisy, commands=["u"], targets=["y"], forward=forward)
    return polynomial_inverse(data, degree=2, past=(1,))
