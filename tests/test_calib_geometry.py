"""A rendered target must give back the camera that rendered it."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from scipy.interpolate import RectBivariateSpline

from bssrdf.calib.geometry import calibrate_geometry
from bssrdf.calib.surface import Surface, undistort
from bssrdf.calib.target import Target, find_target
from bssrdf.errors import InputError
from bssrdf.session.records import Distortion, Geometry

SIZE = (900, 640)
FOCAL_PX = 1400.0
CAMERA = np.array([[FOCAL_PX, 0, 455.0], [0, FOCAL_PX, 316.0], [0, 0, 1]])
LENS = (-0.12, 0.05, 0.0006, -0.0004)
BOARD = Target(columns=12, rows=12, pitch_mm=3.0)
PX_PER_MM = 40


def true_mm(x_px, y_px, tilt_deg, distance_mm=75.0):
    """Where a pixel's ray meets the plate, which is tilted about the image's x axis."""
    lens = Distortion(tuple(map(tuple, CAMERA.tolist())), LENS)
    x, y = undistort(lens, x_px, y_px)
    rays = np.stack([(x - CAMERA[0, 2]) / FOCAL_PX, (y - CAMERA[1, 2]) / FOCAL_PX, np.ones_like(x)])
    tilt = np.radians(tilt_deg)
    along = np.array([0, np.cos(tilt), np.sin(tilt)])
    normal = np.array([0, -np.sin(tilt), np.cos(tilt)])
    depth = distance_mm * normal[2] / np.tensordot(normal, rays, 1)
    middle = BOARD.pitch_mm * BOARD.columns / 2
    return rays[0] * depth + middle, np.tensordot(
        along, rays * depth - np.array([0, 0, distance_mm])[:, None], 1
    ) + middle


def render(tilt_deg, seed=0):
    """The plate through lens and perspective, three samples per pixel each way, with noise."""
    texture = BOARD.board().generateImage((BOARD.columns * 120,) * 2).astype(np.float32)
    pixels_per_mm = texture.shape[0] / (BOARD.columns * BOARD.pitch_mm)
    coarse_x, coarse_y = np.arange(-10.0, SIZE[0] + 11, 10), np.arange(-10.0, SIZE[1] + 11, 10)
    grid = np.meshgrid(coarse_x, coarse_y)
    places = [m.reshape(grid[0].shape) for m in true_mm(grid[0].ravel(), grid[1].ravel(), tilt_deg)]
    fine_x, fine_y = ((np.arange(3 * n) - 1) / 3 for n in SIZE)
    to_texture = [RectBivariateSpline(coarse_y, coarse_x, m)(fine_y, fine_x) * pixels_per_mm - 0.5 for m in places]
    fine = cv2.remap(texture, *(m.astype(np.float32) for m in to_texture), cv2.INTER_LINEAR, borderValue=200.0)
    image = fine.reshape(SIZE[1], 3, SIZE[0], 3).mean((1, 3))
    noise = np.random.default_rng(seed).normal(0, 80, image.shape)
    return np.clip(2000 + 180 * cv2.GaussianBlur(image, (0, 0), 0.7) + noise, 0, 65535).astype(np.uint16)


@pytest.mark.parametrize("tilt_deg", [30.0, 45.0])
def test_a_charuco_plate_gives_every_pixel_its_place(tmp_path, tilt_deg):
    tifffile.imwrite(tmp_path / "plate.tif", render(tilt_deg))
    found = calibrate_geometry([tmp_path / "plate.tif"], BOARD, "mono")
    x, y = (
        a.ravel().astype(float) for a in np.meshgrid(np.linspace(0, SIZE[0] - 1, 37), np.linspace(0, SIZE[1] - 1, 27))
    )
    on_plate = np.all((np.array(true_mm(x, y, tilt_deg)) > 0) & (np.array(true_mm(x, y, tilt_deg)) < 36), axis=0)
    x, y = x[on_plate], y[on_plate]
    surface = Surface(found.geometry, found.distortion)
    miss_mm = np.subtract(surface.to_mm(x, y), true_mm(x, y, tilt_deg))
    miss_px = np.linalg.solve(np.moveaxis(surface.jacobian(x, y), 2, 0), miss_mm.T[:, :, None])[:, :, 0]
    assert np.hypot(*miss_px.T).max() < 0.1
    assert found.residual_px < 0.1
    assert found.geometry.view_angle_deg == pytest.approx(tilt_deg, abs=0.5)
    assert found.geometry.view_axis == "y"


def test_pixel_areas_add_up_to_the_area_of_the_plate():
    geometry = Geometry(mm_per_px=0.05, view_angle_deg=60.0)
    assert Surface(geometry).pixel_area_mm2(np.array([3.0]), np.array([4.0])) == pytest.approx(0.05**2 / 0.5)
    tilted = Geometry(homography=((0.05, 0, 0), (0, 0.1, 0), (0, 0.001, 1)))
    y = np.arange(100.0)
    strip = Surface(tilted).to_mm(np.zeros(2), np.array([-0.5, 99.5]))[1]
    widths = Surface(tilted).jacobian(np.zeros(100), y)[0, 0]
    assert np.sum(Surface(tilted).pixel_area_mm2(np.zeros(100), y) / widths) == pytest.approx(
        strip[1] - strip[0], rel=1e-6
    )


def test_an_image_without_a_target_is_an_error(tmp_path):
    tifffile.imwrite(tmp_path / "blank.tif", np.full((300, 400), 1000, np.uint16))
    with pytest.raises(InputError, match=r"blank.tif: shows 0 points of the 12 x 12 charuco target"):
        calibrate_geometry([tmp_path / "blank.tif"], BOARD, "mono")


def test_a_dot_grid_serves_as_well(tmp_path):
    y, x = np.mgrid[:400, :500].astype(float)
    image = np.full((400, 500), 60000.0)
    for row in range(9):
        for column in range(11):
            image -= 50000 / (1 + np.exp(np.hypot(x - 60.4 - 38 * column, (y - 50.2 - 30 * row) / 0.8) - 8))
    tifffile.imwrite(tmp_path / "dots.tif", image.astype(np.uint16))
    found = calibrate_geometry([tmp_path / "dots.tif"], Target(11, 9, 2.0, "dots"), "mono")
    u, v = Surface(found.geometry, found.distortion).to_mm(np.array([60.4, 440.4]), np.array([50.2, 290.2]))
    assert np.hypot(u[1] - u[0], v[1] - v[0]) == pytest.approx(np.hypot(20, 16), rel=1e-3)


def turned(plate, px_per_mm, tilt_deg=45.0):
    """A drawn plate seen from 260 mm under a tilt, and the true scale [mm/px] across the view in the middle."""
    width, height, focal, distance = 800, 560, 1200.0, 260.0
    tilt = np.radians(tilt_deg)
    rotation = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    camera = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    size_mm = np.array(plate.shape[::-1]) / px_per_mm
    to_mm = np.array([[1 / px_per_mm, 0, -size_mm[0] / 2], [0, 1 / px_per_mm, -size_mm[1] / 2], [0, 0, 1]])
    seen = camera @ np.c_[rotation[:, :2], [0, 0, distance]] @ to_mm
    large = cv2.warpPerspective(
        plate, np.diag([4, 4, 1.0]) @ seen, (4 * width, 4 * height), flags=cv2.INTER_AREA, borderValue=200
    )
    noise = np.random.default_rng(0).normal(0, 1.0, (height, width))
    return np.clip(cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA) + noise, 0, 255), distance / focal


def board(columns, rows, *, legacy=False, markers=True):
    if not markers:
        return (np.indices((rows * 150, columns * 150)) // 150).sum(0).astype(np.uint8) % 2 * 255
    drawn = Target(columns, rows, 15.0).board(legacy=legacy)
    return drawn.generateImage((columns * 150, rows * 150))


def dots(columns, rows, *, light=False, offset=False):
    step = (100, 50) if offset else (100, 100)
    plate = np.full(((rows + 1) * step[1], (columns + 1) * step[0]), 0 if light else 255, np.uint8)
    for row in range(rows):
        for column in range(columns):
            centre = (int((column + 1 + (row % 2 / 2 if offset else 0)) * step[0]), (row + 1) * step[1])
            cv2.circle(plate, centre, 17 if offset else 25, 255 if light else 0, -1, cv2.LINE_AA)
    return plate


PLATES = {
    "odd": (board(9, 7), Target(9, 7, 15.0)),
    "even": (board(8, 6), Target(8, 6, 15.0)),
    "even, before OpenCV 4.6": (board(8, 6, legacy=True), Target(8, 6, 15.0)),
    "columns and rows exchanged": (board(9, 7), Target(7, 9, 15.0)),
    "negative": (255 - board(8, 6, legacy=True), Target(8, 6, 15.0)),
    "chessboard": (board(9, 7, markers=False), Target(9, 7, 15.0)),
    "dots": (dots(11, 9), Target(11, 9, 10.0, "dots")),
    "white dots on black": (dots(11, 9, light=True), Target(11, 9, 10.0, "dots")),
    "offset dots": (dots(7, 15, offset=True), Target(7, 15, 10.0, "dots")),
    "offset dots, even": (dots(7, 16, offset=True), Target(7, 16, 10.0, "dots")),
    "white offset dots, exchanged": (dots(7, 15, light=True, offset=True), Target(15, 7, 10.0, "dots")),
}


@pytest.mark.parametrize("name", PLATES)
def test_every_common_plate_gives_the_scale(tmp_path, name):
    plate, target = PLATES[name]
    image, mm_per_px = turned(plate, 10)
    tifffile.imwrite(tmp_path / "plate.tif", (600 + 50 * image).astype(np.uint16))
    found = calibrate_geometry([tmp_path / "plate.tif"], target, "mono")
    x, y = Surface(found.geometry, found.distortion).to_mm(np.array([399.0, 400.0]), np.array([279.5, 279.5]))
    assert np.hypot(np.diff(x), np.diff(y)) == pytest.approx(mm_per_px, rel=1e-3)
    assert found.geometry.view_angle_deg == pytest.approx(45, abs=0.3)
    assert found.residual_px < 0.1


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_plate_may_be_a_picture_that_is_not_linear(tmp_path, suffix):
    image, mm_per_px = turned(board(9, 7), 10)
    cv2.imwrite(str(tmp_path / f"plate{suffix}"), 255 * (image / 255) ** (1 / 2.2))
    found = calibrate_geometry([tmp_path / f"plate{suffix}"], Target(9, 7, 15.0), "mono")
    x, _ = Surface(found.geometry, found.distortion).to_mm(np.array([399.0, 400.0]), np.array([279.5, 279.5]))
    assert abs(np.diff(x)) == pytest.approx(mm_per_px, rel=1e-3)


def test_plates_of_two_sizes_are_refused(tmp_path):
    image, _ = turned(board(9, 7), 10)
    cv2.imwrite(str(tmp_path / "raw.png"), image)
    cv2.imwrite(str(tmp_path / "small.jpg"), cv2.resize(image, None, fx=0.8, fy=0.8))
    with pytest.raises(InputError, match=r"small\.jpg: has 640 x 448 px, not 800 x 560 as the first"):
        calibrate_geometry([tmp_path / "raw.png", tmp_path / "small.jpg"], Target(9, 7, 15.0), "mono")


def test_dots_of_a_large_frame_are_found():
    target = Target(11, 9, 10.0, "dots")
    plate = cv2.resize(dots(11, 9), None, fx=2.5, fy=2.5, interpolation=cv2.INTER_AREA)
    px, mm = find_target(Path("plate.tif"), plate, target)
    assert np.ptp(px, axis=0) / np.ptp(mm, axis=0) == pytest.approx(25, rel=1e-3)


def test_dots_that_lie_otherwise_than_described_are_not_taken(tmp_path):
    with pytest.raises(InputError, match=r"0 points of the 12 x 9 dots target"):
        find_target(Path("plate.tif"), dots(11, 9), Target(12, 9, 10.0, "dots"))
