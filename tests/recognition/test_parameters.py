"""Table I, its ratios and its conditions."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recognition.errors import InvalidParametersError, RecognitionError
from recognition.parameters import R_MAX, R_MIN, ChainParameters


def test_the_radius_of_the_paper_gives_the_parameters_of_the_paper(table_1: ChainParameters) -> None:
    expected = {
        "r": 0.0042,
        "z_t": 0.005,
        "r_c": 0.0042,
        "r_s": 0.0042,
        "rho_t": 0.9,
        "R_t": 0.7,
        "r_n": 0.0042,
        "r_f": 0.0084,
        "r_cn": 0.0126,
        "r_cf": 0.0147,
    }
    # A rounding or two of a double.
    assert {name: getattr(table_1, name) for name in expected} == pytest.approx(expected, rel=1e-14)


@given(st.floats(R_MIN, R_MAX))
def test_every_radius_keeps_the_ratios_and_meets_the_conditions(r: float) -> None:
    # Table I meets r_n + r_f <= r_cn with equality: at many radii rounding puts the sum above r_cn.
    parameters = ChainParameters.for_radius(r)
    lengths = [getattr(parameters, name) / r for name in ("r_c", "r_s", "r_n", "r_f", "r_cn", "r_cf", "z_t")]
    np.testing.assert_allclose(lengths, [1, 1, 1, 2, 3, 3.5, 5 / 4.2], rtol=1e-14)
    assert (parameters.R_t, parameters.rho_t) == (0.7, 0.9)


@pytest.mark.parametrize(
    ("change", "condition"),
    [
        ({"R_t": 1.0}, "0 < R_t < 1"),
        ({"R_t": 0.0}, "0 < R_t < 1"),
        ({"r_n": 0.0}, "0 < r_n"),
        ({"r_n": -0.001}, "0 < r_n"),
        ({"r_f": 0.0042}, "r_n < r_f"),
        ({"r_f": 0.0041}, "r_n < r_f"),
        ({"r_cn": 0.01259}, r"r_n \+ r_f <= r_cn"),
        ({"r_cf": 0.0126}, r"r_cn < r_cf < r_cn \+ r_n"),
        ({"r_cf": 0.0168}, r"r_cn < r_cf < r_cn \+ r_n"),
        ({"z_t": 0.0}, "0 < z_t < 2 r"),
        ({"z_t": 0.0084}, "0 < z_t < 2 r"),
        ({"r_c": 0.0}, "0 < r_c"),
        ({"r_s": -0.001}, "0 < r_s"),
        ({"rho_t": 1.0}, "1/3 < rho_t < 1"),
        ({"rho_t": 1 / 3}, "1/3 < rho_t < 1"),
    ],
)
def test_a_broken_condition_is_refused_and_named(
    table_1: ChainParameters, change: dict[str, float], condition: str
) -> None:
    with pytest.raises(InvalidParametersError, match=f"break .*{condition}"):
        replace(table_1, **change)


def test_all_broken_conditions_are_named_at_once(table_1: ChainParameters) -> None:
    with pytest.raises(InvalidParametersError, match=r"0 < R_t < 1, r_cn < r_cf < r_cn \+ r_n \(Table I\)"):
        replace(table_1, R_t=2.0, r_cf=0.02)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "0.0084", None])
def test_a_parameter_that_is_no_number_is_refused(table_1: ChainParameters, value: Any) -> None:
    with pytest.raises(InvalidParametersError, match=f"r_f is {value!r}; a finite number is needed"):
        replace(table_1, r_f=value)


@pytest.mark.parametrize(
    ("r", "message"),
    [
        (0.0, "must be positive"),
        (-0.0042, "must be positive"),
        (0.0001, r"it must be from 0.0005 to 0.02 m \(metres, not mm\)"),
        (4.2, r"it must be from 0.0005 to 0.02 m \(metres, not mm\)"),
        (0.1, "it must be from 0.0005 to 0.02 m"),
        (float("nan"), "the string radius is nan; a length in metres is needed"),
        (float("inf"), "the string radius is inf; a length in metres is needed"),
        ("4.2", "the string radius is '4.2'; a length in metres is needed"),
        (None, "the string radius is None; a length in metres is needed"),
    ],
)
def test_a_radius_out_of_range_is_refused(r: Any, message: str) -> None:
    with pytest.raises(InvalidParametersError, match=message):
        ChainParameters.for_radius(r)


def test_the_refusal_is_a_recognition_error_with_its_own_slug() -> None:
    assert issubclass(InvalidParametersError, RecognitionError)
    assert InvalidParametersError.slug == "invalid-parameters"
