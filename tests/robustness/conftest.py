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


@pytest.fixture(scope="module", autouse=True)
def no_data_folder():
    """Files stand beside their descriptions, whatever the user has set."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("JAXNARX_DATA", raising=False)
        yield
