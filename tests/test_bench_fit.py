"""The bench of fits: its camera curves are what the forward model makes, so that a fit finds their media again."""

from __future__ import annotations

import numpy as np
import pytest

from bssrdf.bench.camera_curves import camera_slices, fit_camera
from bssrdf.fit import FitOptions, fit_slice
from bssrdf.rig import published_sample
from bssrdf.transport import CHANNELS


@pytest.mark.parametrize("name", ["Marble", "Skin1"])
def test_a_camera_curve_of_the_bench_fits_at_chi2_of_1_and_leads_back_to_its_medium(name: str) -> None:
    (piece,) = (each for each in camera_slices(3) if each.material == name)
    for channel, found in fit_slice(piece, FitOptions(model="mc", tables="shipped")).items():
        medium = published_sample(name).media[channel]
        assert found.status == "converged"
        assert found.chi2_reduced == pytest.approx(1, abs=0.3)  # of 134: 2.5 sd
        assert found.sigma_sp_per_mm == pytest.approx(medium.sigma_sp, abs=3 * found.sigma_sp_sd_per_mm)
        assert found.sigma_a_per_mm == pytest.approx(medium.sigma_a, abs=3 * found.sigma_a_sd_per_mm)


def test_every_channel_of_every_material_is_timed() -> None:
    fitted = fit_camera("mc", 1)
    assert fitted.found.sigma_a.shape == fitted.sigma_a.shape == (12 * len(CHANNELS),)
    assert fitted.found.seconds_each > 0
    assert np.nanmedian(np.abs(fitted.found.sigma_sp / fitted.sigma_sp - 1)) < 0.01
