"""`measure --from-hdr`: the merged images in place of the frames."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wax_session import write_session

from bssrdf.errors import InputError
from bssrdf.measure.hdr import SATURATED, Hdr
from bssrdf.measure.session import measure_session
from bssrdf.measure.stored import StoredHdr
from bssrdf.measure.summary import read_summary
from bssrdf.session.flags import Flag
from bssrdf.session.frames_csv import read_frames, write_frames
from bssrdf.session.hdr_image import HdrExr, read_hdr_exr, write_hdr_exr


def curve_files(folder):
    return {name: (folder / name).read_bytes() for name in ("slice.csv", "slice.png")}


def test_a_curve_from_the_merged_images_is_that_of_the_whole_run_and_reads_no_frame(tmp_path):
    session = write_session(tmp_path / "again")
    whole = measure_session(session)
    before = curve_files(session.path / "measured")
    radial = measure_session(session, radial=True)
    measure_session(session)
    shutil.rmtree(session.path / "frames")
    again = measure_session(session, from_hdr=True)
    assert curve_files(session.path / "measured") == before
    assert (again.slice.total_r, again.slice.total_r_sd) == (whole.slice.total_r, whole.slice.total_r_sd)
    for name, part in measure_session(session, from_hdr=True, radial=True).slice.channels.items():
        np.testing.assert_array_equal(part.rd_per_mm2, radial.slice.channels[name].rd_per_mm2)


def squares_read(monkeypatch):
    """The pixels of each part that are read from then on, by part."""
    read, n_read = HdrExr.window, dict[str, int]()

    def watched(self, part, rows, columns):
        window = read(self, part, rows, columns)
        n_read[part] = n_read.get(part, 0) + window.size
        return window

    monkeypatch.setattr(HdrExr, "window", watched)
    return n_read


def test_a_curve_read_again_needs_the_pixels_near_the_slice_alone(tmp_path, monkeypatch):
    session = write_session(tmp_path / "tall", shape=(2000, 120))
    measure_session(session)
    before = curve_files(session.path / "measured")
    n_read = squares_read(monkeypatch)
    measure_session(session, from_hdr=True)
    assert curve_files(session.path / "measured") == before
    assert n_read.keys() == {"radiance", "variance", "mask"}
    assert max(n_read.values()) < 0.6 * 2 * 2000 * 120


@pytest.mark.parametrize(("colours", "tile_px"), [((), 0), ((), 128), ((3,), 128)])
def test_a_window_of_a_stored_image_is_that_of_the_image_and_of_squares_read_once(
    tmp_path, monkeypatch, colours, tile_px
):
    monkeypatch.setattr("bssrdf.session.hdr_image._TILE_PX", tile_px)
    rng, shape = np.random.default_rng(0), (300, 700, *colours)
    radiance, variance = rng.normal(size=(2, *shape)).astype(np.float32)
    count, mask = rng.integers(0, 5, (2, *shape)).astype(np.uint16)
    hdr = Hdr(radiance, variance, count, mask.astype(np.uint8))
    write_hdr_exr(tmp_path / "a.exr", vars(hdr), {})
    stored, n_read = StoredHdr(tmp_path / "a.exr"), squares_read(monkeypatch)
    windows = [(slice(140, 150), slice(10, 20)), (slice(100, 140), slice(300, 301)), (slice(5, 300), slice(0, None))]
    for rows, columns in [*windows, (slice(None), slice(None))]:
        for ours, its in zip(hdr.window(rows, columns), stored.window(rows, columns), strict=True):
            np.testing.assert_array_equal(ours, its)
        if rows == windows[0][0]:
            assert n_read["mask"] == 128 * 128 * radiance[0, 0].size
    np.testing.assert_array_equal(stored.count, count)
    before = n_read["radiance"]
    assert stored.window(slice(1, 299), slice(0, 700)).mask.shape == (298, *shape[1:])
    assert n_read["radiance"] == before


@pytest.mark.parametrize("spoil", [Path.unlink, Path.touch, lambda path: path.write_bytes(path.read_bytes()[:9999])])
def test_without_its_summary_an_image_is_read_whole_and_summed_up_anew(tmp_path, spoil):
    session = write_session(tmp_path / "again")
    measure_session(session)
    before, summary = curve_files(session.path / "measured"), session.path / "measured/sample.npz"
    spoil(summary if spoil is not Path.touch else summary.with_suffix(".exr"))
    measure_session(session, from_hdr=True)
    assert curve_files(session.path / "measured") == before
    assert read_summary(summary, summary.with_suffix(".exr")) is not None


def test_an_image_changed_by_hand_is_taken_as_it_is_now(tmp_path):
    session = write_session(tmp_path / "edited")
    assert Flag.GLINT not in measure_session(session).slice.flags
    path = session.path / "measured/sample.exr"
    parts, provenance = read_hdr_exr(path)
    parts["mask"][5, 5] = SATURATED
    write_hdr_exr(path, parts, provenance)
    assert Flag.GLINT in measure_session(session, from_hdr=True).slice.flags


def test_images_of_other_frames_or_another_camera_are_refused(tmp_path):
    session = write_session(tmp_path / "stale")
    with pytest.raises(InputError, match=r"sample.exr: is not there; run `bssrdf measure` without --from-hdr"):
        measure_session(session, from_hdr=True)
    measure_session(session)
    brighter = replace(session, camera=replace(session.camera, white=9000.0))
    with pytest.raises(InputError, match=r"before frames.csv or \[camera\] changed"):
        measure_session(brighter, from_hdr=True)
    assert measure_session(replace(session, camera=replace(session.camera, aperture_mm=1.0)), from_hdr=True).slice
    frames = read_frames(session.path)
    write_frames(session.path, frames[1:])
    with pytest.raises(InputError, match=r"before frames.csv or \[camera\] changed"):
        measure_session(session, from_hdr=True)
    write_frames(session.path, [replace(frames[0], sha256="0" * 64), *frames[1:]])
    with pytest.raises(InputError, match=r"was made from another frames/sample_0.tif"):
        measure_session(session, from_hdr=True)
    write_frames(session.path, frames)
    measure_session(write_session(tmp_path / "other", seed=5))
    shutil.copy(tmp_path / "other/measured/reference.exr", session.path / "measured/reference.exr")
    with pytest.raises(InputError, match=r"reference.exr: comes from another run"):
        measure_session(session, from_hdr=True)
