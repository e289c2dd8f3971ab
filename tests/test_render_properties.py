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
from mitsuba_scenes import MARBLE, SKY, around, radiance, scene_of, towards_origin

from bssrdf.transport import dipole

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
        ({"type": "bssrdf", "kernel": "dipole", "terms": "diffusion,double"}, "some of diffusion, single, specular"),
        ({"type": "bssrdf", "terms": "specular"}, "with kernel dipole"),
        ({"type": "bssrdf", "kernel": "best"}, "table or dipole"),
        ({"type": "bssrdf", "method": "probes"}, "points or walks"),
        ({"type": "bssrdf", "max_depth": 0}, "above 0"),
    ],
)
def test_wrong_properties_are_named_with_what_to_give(plugin: dict[str, Any], says: str) -> None:
    with pytest.raises(Exception, match=says):
        mi.load_dict(plugin)
