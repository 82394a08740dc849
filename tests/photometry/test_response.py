"""From stored values to linear light and back."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.errors import ImageError
from liaam.photometry import (
    ResponseCurve,
    describe_response,
    from_linear,
    linear_to_srgb,
    log_slope,
    parse_response,
    srgb_to_linear,
    to_linear,
)


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


@pytest.mark.parametrize(
    ("text", "response"),
    [("srgb", "srgb"), ("linear", "linear"), ("2.2", 2.2), (1.8, 1.8), (0.2, 0.2), ("5", 5.0)],
)
def test_responses_as_people_write_them(text, response):
    assert parse_response(text) == response


@pytest.mark.parametrize("text", ["sRGBB", "0", "nan", "inf", "-2", "100", "", "0.19", 5.01, None, [2.2]])
def test_an_unknown_response_is_refused_with_what_exists(text):
    with pytest.raises(ImageError, match=r"use 'srgb', 'linear' or a gamma between 0\.2 and 5"):
        parse_response(text)


def test_srgb_is_two_pieces():
    values = np.array([0.0, 0.02, 0.04045, 0.0405, 0.2, 1.0])
    linear = [0.0, 0.02 / 12.92, 0.04045 / 12.92, *(((values[3:] + 0.055) / 1.055) ** 2.4)]
    np.testing.assert_allclose(srgb_to_linear(values), linear, rtol=1e-14)
    encoded = [0.002 * 12.92, 0.0031308 * 12.92, *(1.055 * np.array([0.0032, 0.5]) ** (1 / 2.4) - 0.055)]
    np.testing.assert_allclose(linear_to_srgb(np.array([0.002, 0.0031308, 0.0032, 0.5])), encoded, rtol=1e-14)
    assert not np.isnan(srgb_to_linear(np.array([-0.5]))).any() and not np.isnan(linear_to_srgb(np.array([-0.5]))).any()


# Curves


GAMMA = ResponseCurve((0.1, 0.5, 1.0), (0.1**2.2, 0.5**2.2, 1.0))


def test_curves_are_given_and_written_by_their_points():
    facts = {"stored": [0.1, 0.5, 1.0], "linear": [0.1**2.2, 0.5**2.2, 1.0]}
    assert parse_response(facts) == GAMMA
    assert parse_response(GAMMA) is GAMMA
    assert describe_response(GAMMA) == facts
    assert [describe_response(response) for response in ("srgb", "linear", 2.2)] == ["srgb", "linear", 2.2]
    for wrong in (facts | {"gamma": 2.2}, {"stored": [0.1, 1.0]}):
        with pytest.raises(ImageError, match="exactly the entries 'stored' and 'linear'"):
            parse_response(wrong)


@pytest.mark.parametrize(
    ("stored", "linear", "words"),
    [
        ((0.1, 1.0), (0.1, 0.5, 1.0), "two or more pairs"),
        ((1.0,), (1.0,), "two or more pairs"),
        ((0.0, 1.0), (0.1, 1.0), "two or more pairs of positive"),
        ((0.1, 1.0), (0.0, 1.0), "two or more pairs of positive"),
        ((0.1, float("nan")), (0.1, 1.0), "two or more pairs"),
        ((0.1, 1.0), (0.1, float("inf")), "two or more pairs"),
        ((0.1, 0.1), (0.1, 1.0), "must increase from point to point"),
        ((0.5, 0.1), (0.1, 1.0), "must increase from point to point"),
        ((0.1, 1.0), (0.5, 0.5), "must increase from point to point"),
        ((0.1, 1.001), (0.1, 1.0), "stored values of at most 1"),
        ((0.1, 1.0), (9.9e-6, 9.9e-5), "maps white to linear light of about 1e-4: .* between 0.0001 and 10000"),
        ((0.1, 1.0), (1.1e2, 1.1e4), "maps white to linear light of about 1e4"),
        ((0.02, 1.0), (0.02**10.1, 1.0), r"an overall gamma of 10\.1; the maximum is 10"),
        ((0.5, 0.500001, 1.0), (0.1, 0.5, 1.0), "two almost equal stored values"),
        ((1e-3, np.nextafter(1e-3, 1), 1.0), (1e-3, np.nextafter(1e-3, 1), 1.0), "two almost equal stored values"),
    ],
)
def test_points_that_are_no_response_are_refused(stored, linear, words):
    with pytest.raises(ImageError, match=words):
        ResponseCurve(stored, linear)


@pytest.mark.parametrize(
    ("stored", "linear"),
    [
        ((0.1, 1.0), (0.1, 1.0)),
        ((0.5, 0.9), (0.2, 1.0)),
        ((0.02, 1.0), (0.02**9.9, 1.0)),
        ((0.1, 1.0), (1.001e-5, 1.001e-4)),
        ((0.1, 1.0), (0.999e3, 0.999e4)),
        ((0.01, 0.02, 1.0), (1e-12, 0.5e-2, 1.0)),
    ],
)
def test_points_at_the_limits_are_a_response(stored, linear):
    assert to_linear(np.array(stored[-1]), ResponseCurve(stored, linear)) == pytest.approx(linear[-1])


def test_a_curve_has_as_many_points_as_16_bits_have_values():
    def curve(n: int) -> ResponseCurve:
        points = tuple(np.linspace(0.01, 1.0, n))
        return ResponseCurve(points, points)

    assert len(curve(65536).stored) == 65536
    with pytest.raises(ImageError, match="a response curve of 65537 points: give at most 65536"):
        curve(65537)


def test_beyond_its_points_a_curve_is_a_power():
    stored = np.array([0.02, 0.05])
    steep = ResponseCurve((0.1, 0.11, 1.0), (1e-4, 1e-3, 1.0))  # far steeper than 5 at its first point
    ratio = to_linear(stored, steep)
    assert np.log(ratio[1] / ratio[0]) / np.log(2.5) == pytest.approx(5.0)
    np.testing.assert_allclose(log_slope(stored, steep), 5.0 / stored)
    assert log_slope(np.array(0.1), steep) > 100  # at the point itself
    np.testing.assert_allclose(from_linear(ratio, steep), stored, rtol=1e-9)
    flat = ResponseCurve((0.1, 0.5, 0.50001, 0.6), (0.1, 0.9, 0.9000000001, 1.0))  # almost flat in between
    values = np.linspace(0.1, 0.9, 50)
    assert (log_slope(values, flat) * values).min() >= 1e-3
    assert log_slope(np.array(0.500005), flat) * 0.500005 == pytest.approx(1e-3)
    above = np.array([0.7, 0.9])
    np.testing.assert_allclose(from_linear(to_linear(above, flat), flat), above, rtol=1e-6)


def test_what_is_black_has_no_light_under_a_curve():
    assert to_linear(np.array([-1.0, 0.0, 1e-12]), GAMMA).tolist() == [0.0, 0.0, 0.0]
    assert from_linear(np.array([-1.0, 0.0, 1e-12]), GAMMA).tolist() == [0.0, 0.0, 0.0]
    assert to_linear(np.array(1e-6), GAMMA) == pytest.approx(1e-6**2.2)
    assert from_linear(np.array(1e-9), GAMMA) == pytest.approx(1e-9 ** (1 / 2.2))


def test_a_curve_is_inverted_to_the_last_digits():
    bent = ResponseCurve((0.05, 0.2, 0.4, 0.9), (0.001, 0.05, 0.2, 0.95))
    values = np.geomspace(0.002, 1.5, 400)
    np.testing.assert_allclose(from_linear(to_linear(values, bent), bent), values, rtol=1e-12)


def test_pictures_are_srgb_unless_told_otherwise():
    values = np.array([0.02, 0.5, 0.9])
    np.testing.assert_array_equal(to_linear(values), srgb_to_linear(values))
    np.testing.assert_array_equal(from_linear(values), linear_to_srgb(values))
    np.testing.assert_array_equal(log_slope(values), log_slope(values, "srgb"))
    assert log_slope(np.array(0.04045)) == pytest.approx(1 / 0.04045)
