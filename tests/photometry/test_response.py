"""From stored values to linear light and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from liaam.errors import ImageError
from liaam.photometry import from_linear, linear_to_srgb, log_slope, parse_response, srgb_to_linear, to_linear


@given(value=st.floats(0, 1))
def test_srgb_encodes_what_it_decodes(value):
    # The standard's two pieces meet to about 1e-7 only.
    assert linear_to_srgb(srgb_to_linear(value)) == pytest.approx(value, abs=1e-6)


def test_srgb_knows_the_standards_values():
    np.testing.assert_allclose(srgb_to_linear([0, 0.04045, 0.5, 1]), [0, 0.0031308, 0.2140411, 1], atol=1e-7)


@pytest.mark.parametrize("response", ["srgb", "linear", 2.2])
def test_every_response_is_monotonic_from_0_to_1(response):
    linear = to_linear(np.linspace(0, 1, 1000), response)
    assert (np.diff(linear) > 0).all()
    assert (linear[0], linear[-1]) == pytest.approx((0, 1))


def test_a_gamma_is_a_power():
    assert to_linear(np.array(0.5), 2.2) == pytest.approx(0.5**2.2)


RESPONSES = st.one_of(st.sampled_from(["srgb", "linear"]), st.floats(0.2, 5.0))


@given(value=st.floats(0, 1), response=RESPONSES)
def test_every_response_encodes_what_it_decodes(value, response):
    assert from_linear(to_linear(np.array(value), response), response) == pytest.approx(value, abs=1e-6)
    assert to_linear(from_linear(np.array(value), response), response) == pytest.approx(value, abs=1e-6)


def test_what_is_below_black_has_no_power():
    assert from_linear(np.array([-0.1, 0.0]), 2.2).tolist() == [0.0, 0.0]


@given(value=st.floats(1e-3, 1), response=RESPONSES)
def test_the_slope_of_the_logarithm_is_its_derivative(value, response):
    step = 1e-6 * value
    if response == "srgb" and abs(value - 0.04045) < 2 * step:  # the two pieces meet there with a bend
        return
    logs = np.log(to_linear(np.array([value - step, value + step]), response))
    assert log_slope(np.array(value), response) == pytest.approx(np.diff(logs)[0] / (2 * step), rel=1e-5)


@pytest.mark.parametrize("response", ["srgb", "linear", 2.2])
def test_slopes_of_many_values_are_those_of_each(response):
    values = np.linspace(0.001, 1, 500).reshape(100, 5)
    slopes = log_slope(values, response)
    assert slopes.shape == values.shape
    assert slopes[3, 2] == log_slope(values[3, 2], response)
    assert (np.diff(slopes.ravel()) <= 0.02 * slopes.ravel()[1:]).all()  # dark values magnify noise


@pytest.mark.parametrize(("text", "response"), [("srgb", "srgb"), ("linear", "linear"), ("2.2", 2.2), (1.8, 1.8)])
def test_responses_as_people_write_them(text, response):
    assert parse_response(text) == response


@pytest.mark.parametrize("text", ["sRGBB", "0", "nan", "inf", "-2", "100", ""])
def test_an_unknown_response_is_refused_with_what_exists(text):
    with pytest.raises(ImageError, match=r"use 'srgb', 'linear' or a gamma between 0\.2 and 5"):
        parse_response(text)
