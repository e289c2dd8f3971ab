"""Least squares of few parameters: what SciPy finds, or a smaller sum; parameters that no data tell stay in bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares as scipys
from scipy.special import i0e

from bssrdf.calib.beam_radius import scaled_i0
from bssrdf.calib.few_parameters import least_squares


def decay(seed: int):
    """Residuals of a decay with a floor in noise, by the logarithms of scale and rate, and the floor."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0.1, 8, 60)
    scale, rate, floor = rng.uniform(0.5, 3), rng.uniform(0.2, 2), rng.uniform(-0.1, 0.1)
    sd = 10 ** rng.uniform(-4, -1)
    y = scale * np.exp(-rate * x) + floor + sd * rng.standard_normal(x.size)
    return lambda p: (np.exp(p[0]) * np.exp(-np.exp(p[1]) * x) + p[2] - y) / sd


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("least_floor", [-1.0, 0.02])
def test_the_minimum_is_scipys_inside_and_at_a_bound(seed: int, least_floor: float) -> None:
    low, high = np.array([-5.0, -5.0, least_floor]), np.array([5.0, 3.0, 1.0])
    start = np.array([0.0, 0.0, max(0.0, least_floor)])
    ours = least_squares(decay(seed), start, low, high, longest=1.0)
    theirs = scipys(decay(seed), start + 1e-9, bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert ours.cost <= theirs.cost * (1 + 1e-6)
    sd = np.sqrt(np.diag(np.linalg.pinv(theirs.jac.T @ theirs.jac)))
    assert np.all(np.abs(ours.x - theirs.x) < 0.01 * sd + 1e-6)
    assert np.all((ours.x >= low) & (ours.x <= high))


def test_a_curved_valley_is_followed_to_its_end() -> None:
    unbounded = np.full(2, np.inf)
    found = least_squares(
        lambda p: np.array([10 * (p[1] - p[0] ** 2), 1 - p[0]]), np.array([-1.2, 1.0]), -unbounded, unbounded
    )
    np.testing.assert_allclose(found.x, [1, 1], rtol=1e-6)


def test_a_parameter_that_nothing_tells_does_no_harm() -> None:
    bounds = np.full(2, 4.0)
    found = least_squares(lambda p: np.array([p[0] - 1, 2 * p[0] - 2]), np.array([3.0, 2.0]), -bounds, bounds)
    np.testing.assert_allclose(found.x, [1, 2], rtol=1e-9)


def test_the_bessel_function_of_a_spread_spot_is_scipys() -> None:
    x = np.append(np.geomspace(1e-6, 1e6, 2000), [0.0, 599.999, 600.0])
    np.testing.assert_allclose(scaled_i0(x), i0e(x), rtol=2e-12)
