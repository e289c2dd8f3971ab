"""The walk that makes light for tests: its curves in fixtures/ are its own, and its totals are the exact ones."""

from __future__ import annotations

import numpy as np
import pytest
from builders import curve
from literal_walk import MEDIA, light_of, mean_se

from bssrdf.transport.discrete_ordinates import half_space


@pytest.mark.parametrize("name", MEDIA)
def test_a_shipped_curve_is_what_the_walk_makes(name: str) -> None:
    known = curve(f"walk/{name}")
    edges, rd, total = light_of(MEDIA[name], 20_000, seed=2)
    value, error = (each[: known.rd.size] for each in mean_se(rd))
    np.testing.assert_allclose(edges[1 : known.rd.size + 1], known.r_hi, rtol=1e-5)
    told = (error > 0) & (error < 0.2 * value)
    z = (value - known.rd)[told] / np.hypot(error, known.se)[told]
    assert np.mean(z**2) < 2
    assert abs(total.mean() - known.total_r) < 4 * mean_se(total)[1]


@pytest.mark.parametrize("name", MEDIA)
def test_its_total_is_that_of_discrete_ordinates(name: str) -> None:
    medium, known = MEDIA[name], curve(f"walk/{name}")
    sigma_s = medium.sigma_sp / (1 - medium.g)
    exact = half_space(sigma_s / (sigma_s + medium.sigma_a), medium.g, medium.eta, np.array([1.0])).total
    assert known.total_r == pytest.approx(exact, rel=1e-3)
