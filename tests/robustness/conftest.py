"""The battery with the seed and the number of cases that the command line asks for."""

import pytest
from battery import Battery


@pytest.fixture
def battery(request) -> Battery:
    option = request.config.getoption
    return Battery(
        option("--robustness-seed"),
        option("--robustness-cases"),
        option("--robustness-first"),
    )
