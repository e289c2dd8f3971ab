"""Images merged elsewhere: what their files leave out is not taken for light."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.measure.hdr import NO_DATA
from bssrdf.measure.merged import read_elsewhere
from bssrdf.session.records import Camera, Card, Frame, Session

Y, X = np.mgrid[:60, :80]
SPOT = np.exp(-np.hypot(X - 40, Y - 30) / 4).astype(np.float32)


def write_window(path: Path, picture: NDArray[np.float32], rows: slice, columns: slice) -> None:
    """A part of the picture as the data window of the whole."""
    part = np.ascontiguousarray(picture[rows, columns, None])
    spec = oiio.ImageSpec(part.shape[1], part.shape[0], 1, "float")
    spec.x, spec.y, spec.full_width, spec.full_height = columns.start, rows.start, 80, 60
    spec.channelnames = ("Y",)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(part)
    assert output.close()


def test_pixels_beyond_the_data_window_have_no_data_and_the_rest_its_place(tmp_path: Path) -> None:
    write_window(tmp_path / "a.exr", SPOT, slice(5, 58), slice(9, 75))
    images, camera = read_elsewhere(Session(tmp_path, Camera()), [Frame("a.exr", "sample_hdr", 1.0)])
    inside = np.zeros(SPOT.shape, bool)
    inside[5:58, 9:75] = True
    hdr = images["sample"]
    np.testing.assert_array_equal(hdr.mask == NO_DATA, ~inside)
    np.testing.assert_array_equal(hdr.radiance[inside], SPOT[inside])
    assert (hdr.variance >= 0).all()
    assert camera.layout == "mono"


@pytest.mark.parametrize(("rows", "columns"), [(slice(31, 60), slice(0, 80)), (slice(0, 60), slice(0, 44))])
def test_data_window_that_cuts_the_spot_is_refused(tmp_path: Path, rows: slice, columns: slice) -> None:
    write_window(tmp_path / "a.exr", SPOT, rows, columns)
    with pytest.raises(InputError, match=r"a\.exr: its data window cuts through the spot"):
        read_elsewhere(Session(tmp_path, Camera()), [Frame("a.exr", "sample_hdr", 1.0)])


def test_layout_is_that_of_the_card_and_one_for_both(tmp_path: Path) -> None:
    for name in ("a.exr", "b.exr"):
        write_window(tmp_path / name, SPOT, slice(0, 60), slice(0, 80))
    frames = [
        Frame(f"{name}.exr", kind, 1.0, card=Card(layout="RGGB"))
        for name, kind in (("a", "sample_hdr"), ("b", "reference_hdr"))
    ]  # type: ignore[arg-type]
    assert read_elsewhere(Session(tmp_path, Camera()), frames)[1].layout == "RGGB"
    assert read_elsewhere(Session(tmp_path, Camera(layout="mono")), frames)[1].layout == "mono"
    with pytest.raises(InputError, match=r"b\.exr: has the layout mono, the image before RGGB"):
        read_elsewhere(Session(tmp_path, Camera()), [frames[0], replace(frames[1], card=Card())])


def test_noise_estimate_of_a_steep_spot_is_never_below_zero(tmp_path: Path) -> None:
    """cv2.blur's running sum comes out at −1e-9 beside a bright spot, and its root was no number."""
    write_window(tmp_path / "a.exr", 1e4 * SPOT**4, slice(0, 60), slice(0, 80))
    images, _ = read_elsewhere(Session(tmp_path, Camera()), [Frame("a.exr", "sample_hdr", 1.0)])
    assert (images["sample"].variance >= 0).all()
