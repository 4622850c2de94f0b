"""What holds for the tests that start processes."""

from collections.abc import Iterator

import pytest

from tests.support.processes.busy import PATIENT_DEADMAN_S


@pytest.fixture(scope="session", autouse=True)
def _patient_gateways() -> Iterator[None]:
    """For every gateway that a test starts, unless the test says otherwise."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CRUISER_COMMAND_DEADMAN_S", str(PATIENT_DEADMAN_S))
        yield
