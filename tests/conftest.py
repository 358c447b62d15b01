"""What is told to pytest on its command line."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("pointchain")
    group.addoption(
        "--host",
        help="with `-m ursim`: the controller to drive in place of the virtual one, as URSim's. ITS ARM MOVES",
    )
    group.addoption("--model", default="ur5e", choices=("ur3e", "ur5e", "ur10e"), help="which arm it has (%(default)s)")
