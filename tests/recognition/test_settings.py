"""Parameters that are set in place of their values for the radius, and which method uses which."""

from dataclasses import asdict, fields
from typing import Any

import pytest

from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.errors import InvalidParametersError
from recognition.model.model import METHODS, Method
from recognition.parameters import USED_BY, ChainParameters, check_settings
from recognition.pipeline import recognise
from recognition.request import RecognitionRequest

R = 0.0042


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    """A string that crosses itself."""
    return simulate(make_scene("loop", 2), camera_model("exact", (320, 200)), 0, views=4)


class Watched(ChainParameters):
    """Parameters that record which of them are read."""

    read: set[str] = set()  # noqa: RUF012 -- one set for every copy

    def __getattribute__(self, name: str) -> Any:
        """Record the name and return the value."""
        if name in USED_BY:
            Watched.read.add(name)
        return super().__getattribute__(name)


class WatchedRequest(RecognitionRequest):
    """Request whose parameters record which of them are read."""

    def parameters_for(self, radius_m: float) -> ChainParameters:
        """Return watched parameters. Their own check reads all of them, and does not count."""
        parameters = Watched(**asdict(super().parameters_for(radius_m)))
        Watched.read.clear()
        return parameters


@pytest.mark.parametrize("method", METHODS)
def test_the_table_lists_the_parameters_that_a_method_reads(scan: SimulatedScan, method: Method) -> None:
    recognise(scan.views, WatchedRequest(method, R))
    assert Watched.read == {name for name, methods in USED_BY.items() if method in methods}


def test_the_table_has_every_parameter_but_the_radius() -> None:
    assert ["r", *USED_BY] == [field.name for field in fields(ChainParameters)]
    assert {method for methods in USED_BY.values() for method in methods} == set(METHODS)


def test_a_setting_replaces_the_value_for_the_radius(scan: SimulatedScan) -> None:
    settings = {"z_t": 0.004, "r_cn": 0.013}
    model = recognise(scan.views, RecognitionRequest(radius_m=R, settings=settings)).model
    assert asdict(model.parameters) == asdict(ChainParameters.for_radius(R)) | settings


def test_settings_are_absolute_where_the_radius_is_measured(scan: SimulatedScan) -> None:
    measured = recognise(scan.views).model.parameters
    changed = recognise(scan.views, RecognitionRequest(settings={"z_t": 0.004})).model.parameters
    assert changed.r == measured.r, "the measurement does not use the settings"
    assert asdict(changed) == asdict(measured) | {"z_t": 0.004}


@pytest.mark.parametrize(
    ("settings", "method", "message"),
    [
        ({"r_c": 0.004}, "graph", "'graph' does not use r_c.*used by enhanced"),
        ({"rho_t": 0.8}, "matching", "'matching' does not use rho_t.*used by enhanced"),
        ({"radius": 0.004}, "graph", "no parameter 'radius'; the parameters are z_t, r_c, r_s"),
        ({"r": 0.004}, "graph", "r is the string radius"),
    ],
)
def test_other_names_are_refused(settings: dict[str, float], method: str, message: str) -> None:
    with pytest.raises(InvalidParametersError, match=message):
        check_settings(settings, method)


def test_a_setting_that_breaks_table_i_is_refused() -> None:
    with pytest.raises(InvalidParametersError, match="r_cn < r_cf < r_cn"):
        ChainParameters.for_radius(R).with_settings({"r_cn": 0.02})
