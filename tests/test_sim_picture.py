"""The simulated picture: light is neither lost nor made on its way from the radial curve to the pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bssrdf.rig.sim.light import SeenLight
from bssrdf.rig.sim.picture import PictureGeometry, picture


def exponential(total: float, length_mm: float) -> SeenLight:
    """Light whose share beyond r is total × exp(−r/length): 1/r at the centre, as R_d is."""
    r = np.concatenate([[0.0], np.geomspace(1e-3, 60 * length_mm, 120)])
    return SeenLight(r, total * np.exp(-r / length_mm))


def surface_sum(image: np.ndarray, view: PictureGeometry) -> float:
    """∫ over the surface, each pixel by the area between its corners."""
    height, width = view.shape
    y, x = np.mgrid[: height + 1, : width + 1] - 0.5
    x_mm, y_mm = view.surface_mm(x, y)
    d1 = np.stack([x_mm[1:, 1:] - x_mm[:-1, :-1], y_mm[1:, 1:] - y_mm[:-1, :-1]])
    d2 = np.stack([x_mm[:-1, 1:] - x_mm[1:, :-1], y_mm[:-1, 1:] - y_mm[1:, :-1]])
    return float((image * abs(d1[0] * d2[1] - d1[1] * d2[0]) / 2).sum())


@pytest.mark.parametrize("angle", [0.0, 45.0, 60.0])
@pytest.mark.parametrize("spot", [0.1, 0.5])
@pytest.mark.parametrize("perspective", [0.0, 0.1])
def test_the_frame_holds_all_the_light(angle: float, spot: float, perspective: float) -> None:
    view = PictureGeometry((400, 600), 0.1, angle, spot_radius_mm=spot, perspective=perspective)
    assert surface_sum(picture(exponential(0.8, 1.0), view), view) == pytest.approx(0.8, rel=2e-3)


def test_far_from_the_spot_the_picture_is_the_curve() -> None:
    view = PictureGeometry((400, 600), 0.1, spot_radius_mm=0.2)
    image = picture(exponential(1.0, 3.0), view)
    x_mm, _ = view.surface_mm(np.arange(600.0), np.full(600, 199.5))
    r = abs(x_mm)
    expected = np.exp(-r / 3.0) / (2 * np.pi * r * 3.0)
    far = (r > 3) & (r < 25)
    middle = image[199:201].mean(0)
    np.testing.assert_allclose(middle[far], expected[far], rtol=3e-3)


def test_the_spot_of_a_surface_without_scattering_is_the_beam() -> None:
    point = SeenLight(np.array([0.0, 1e-4, 2e-4]), np.array([1.0, 1e-9, 1e-12]))
    view = PictureGeometry((101, 101), 0.02, 0.0, spot_radius_mm=0.4)
    image = picture(point, view)
    assert image.max() == pytest.approx(2 / (np.pi * 0.4**2), rel=1e-2)
    assert image[50, 70] / image[50, 50] == pytest.approx(np.exp(-2), rel=1e-2)


def test_a_long_spot_and_fibres_only_move_light_along_their_axes() -> None:
    view = PictureGeometry((400, 600), 0.1, 45.0, spot_radius_mm=0.5)
    for shape in ({"spot_aspect": 1.5}, {"spread_aspect": 1.5}):
        other = replace(view, **shape)
        assert surface_sum(picture(exponential(0.8, 1.0), other), other) == pytest.approx(0.8, rel=2e-3)
    point = SeenLight(np.array([0.0, 1e-4, 2e-4]), np.array([1.0, 1e-9, 1e-12]))
    long = PictureGeometry((201, 201), 0.02, 0.0, spot_radius_mm=0.4, spot_aspect=1.5)
    image, (x_mm, y_mm) = picture(point, long), long.surface_mm(*np.mgrid[:201, :201][::-1].astype(float))
    widths = [np.sqrt(np.average(at**2, weights=image)) for at in (x_mm, y_mm)]
    np.testing.assert_allclose(widths, [0.2, 0.3], rtol=0.01)
    fibres = replace(view, shape=(401, 401), view_angle_deg=0.0, spread_aspect=4.0)
    image = picture(exponential(0.8, 1.0), fibres)
    assert image[200, 240] == pytest.approx(image[210, 200], rel=0.01)


def test_glare_moves_light_within_the_frame() -> None:
    view = PictureGeometry((200, 300), 0.1)
    clean, hazy = (picture(exponential(0.8, 1.0), view, glare) for glare in (0.0, 0.05))
    assert hazy.sum() == pytest.approx(clean.sum())
    assert hazy[0, 0] > 10 * clean[0, 0]
