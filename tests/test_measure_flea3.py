"""A real raw bracket (8 bit, black clipped) must predict each of its own exposures."""

import re
from pathlib import Path

import numpy as np
import pytest

from bssrdf.measure.bracket import bracket_of
from bssrdf.measure.learn import learn_camera
from bssrdf.measure.merge import merge
from bssrdf.session.records import Camera, Frame

FLEA3 = Path(__file__).parents[2] / "shared/data/flea3_bracket"
WELL_EXPOSED_DN = (20, 235)
SATURATED_SHARE = 0.85
"""A frame with more than this saturated is not well exposed: one is, at 550 nm."""


def bracket(wavelength_nm):
    def exposure_s(file):
        return int(re.search(r"_(\d+)ms_", file.name)[1]) / 1000

    files = [("sample", file) for file in sorted(FLEA3.glob(f"frames/*_{wavelength_nm}nm_*"))]
    files += [("dark", file) for file in sorted(FLEA3.glob("darks/*"))]
    frames = [Frame(str(file.relative_to(FLEA3)), kind, exposure_s(file)) for kind, file in files]
    return bracket_of("sample", FLEA3, frames)


@pytest.mark.skipif(not FLEA3.exists(), reason="needs the flea3_bracket data set")
@pytest.mark.parametrize(("wavelength_nm", "tolerance", "n_frames"), [(450, 0.04, 7), (550, 0.04, 6), (600, 0.015, 7)])
def test_the_rest_of_the_bracket_predicts_each_exposure_within_its_stated_error(wavelength_nm, tolerance, n_frames):
    frames = bracket(wavelength_nm)
    learnt = learn_camera([frames], Camera("GBRG", 0.0, 255.0), 2)
    assert learnt.sensor.black_clipped
    shots = frames.shots([learnt.exposures.of(frame.exposure_s) for frame in frames.frames])
    judged = 0
    for held_out in shots:
        raw, dark, _ = held_out.load()
        if np.mean(raw >= learnt.sensor.saturation_dn) > SATURATED_SHARE:
            continue
        judged += 1
        rest = merge([shot for shot in shots if shot is not held_out], learnt.sensor, hot=learnt.hot, period=2)
        usable = (raw > WELL_EXPOSED_DN[0]) & (raw < WELL_EXPOSED_DN[1]) & (rest.mask == 0)
        observed = (raw - dark)[usable]
        predicted = rest.radiance[usable] * held_out.exposure_s
        assert abs(np.median(observed / predicted) - 1) < tolerance, held_out.name
        own = predicted / learnt.sensor.gain_e_per_dn + learnt.sensor.read_var_dn()
        error = np.sqrt(rest.variance[usable] * held_out.exposure_s**2 + own)
        assert np.mean(np.abs(observed - predicted) < 3 * error) > 0.95, held_out.name
    assert judged == n_frames
