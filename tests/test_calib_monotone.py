"""The monotone curve through points, against SciPy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from bssrdf.calib.monotone import Monotone


@given(st.integers(2, 12), st.integers(0, 999), st.booleans())
def test_the_curve_is_that_of_scipy_within_its_points_and_beyond(n, seed, falls):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.1, 2, n))
    y = np.sort(rng.normal(size=n))[::-1] if falls else rng.normal(size=n)
    at = np.linspace(x[0] - 1, x[-1] + 1, 200)
    assert Monotone(x, y)(at) == pytest.approx(PchipInterpolator(x, y, extrapolate=True)(at), rel=1e-9, abs=1e-9)
