"""Media as a scene gives them: textures, seams, open shapes, and wrong properties named."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import mitsuba as mi
from mitsuba_scenes import MARBLE, SKY, VIEW, around, radiance, scene_of, towards_origin

from bssrdf.transport import dipole
from bssrdf.transport.fresnel import fresnel_t
from bssrdf.transport.precision import scoped_x64

Floats = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("mitsuba_mono")


def test_a_flat_texture_is_the_number_in_it() -> None:
    def grey(value: float) -> dict[str, Any]:
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.full((2, 2, 1), value, np.float32)), "raw": True}

    n = 1 << 16
    ball_light = {"shape": {"type": "sphere", "radius": 4.0}, "sky": SKY}
    textured = {"sigma_a": grey(0.01), "sigma_sp": grey(1.0), "eta": 1.3}
    medium = dipole.Medium(0.01, 1.0, 1.3)
    maps = {"reflectance": grey(float(dipole.total_r(medium))), "mean_free_path": grey(1 / 1.01), "eta": 1.3}
    plain, error = radiance(scene_of({"sigma_a": 0.01, "sigma_sp": 1.0, "eta": 1.3}, **ball_light), around(4.0, n), n)
    for other in (textured, maps):
        value, other_error = radiance(scene_of(other, **ball_light), around(4.0, n), n)
        assert abs(value[0] - plain[0]) < 4 * math.hypot(error[0], other_error[0])


def test_on_the_seam_of_two_media_each_half_gives_its_own_light() -> None:
    """Diffusion goes by the coefficients where light entered: half of either total, seen from the seam."""
    first, second = dipole.Medium(0.3, 1.0, 1.3), dipole.Medium(0.003, 1.0, 1.3)
    halves = np.array([[[first.sigma_a], [second.sigma_a]]], np.float32)
    medium = {
        "sigma_a": {"type": "bitmap", "bitmap": mi.Bitmap(halves), "raw": True, "filter_type": "nearest"},
        "sigma_sp": 1.0,
        "eta": 1.3,
    }
    n = 1 << 18
    value, error = radiance(scene_of(medium, sky=SKY), towards_origin(n), n, terms="diffusion")
    totals = [float(scoped_x64(dipole.total_r)(half)) for half in (first, second)]
    expected = float(fresnel_t(1.3, VIEW)) * np.mean(totals)
    assert error[0] < 0.005 * expected
    assert value[0] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("shape", "warns"), [("rectangle", True), ("cube", False), ("sphere", False)])
def test_open_shapes_are_warned_about(shape: str, warns: bool) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        radiance(scene_of(MARBLE, {"type": shape}, sky=SKY), towards_origin(4), 4)
    assert any("is open" in str(warning.message) for warning in caught) == warns


@pytest.mark.parametrize(
    ("plugin", "says"),
    [
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "sigma_sp": 1.0}, "eta is missing"),
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "eta": 1.3}, "sigma_sp is missing"),
        ({"type": "bssrdf_medium", "sigma_a": -1.0, "sigma_sp": 1.0, "eta": 1.3}, "at least 0"),
        ({"type": "bssrdf_medium", "sigma_a": 0.0, "sigma_sp": 0.0, "eta": 1.3}, "the medium is empty"),
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "sigma_sp": 1.0, "eta": 0.7}, "at least 1"),
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "sigma_sp": 1.0, "eta": 1.3, "g": 1.0}, "between -1 and 1"),
        ({"type": "bssrdf", "terms": "diffusion,double"}, "some of diffusion, single, specular"),
        ({"type": "bssrdf", "sampling": "best"}, "exact or exponential"),
        ({"type": "bssrdf", "max_depth": 0}, "above 0"),
    ],
)
def test_wrong_properties_are_named_with_what_to_give(plugin: dict[str, Any], says: str) -> None:
    with pytest.raises(Exception, match=says):
        mi.load_dict(plugin)
