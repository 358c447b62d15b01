"""What tests of faults share."""

import pytest

from tests.service.faults.figures import Figures


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> Figures:
    """What the test measures; its times are asserted where it runs in full."""
    return Figures(request.node.name, request.node.get_closest_marker("soak") is not None)
