"""`measure --from-hdr`: the merged images in place of the frames."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wax_session import write_session

from bssrdf.errors import InputError
from bssrdf.measure.hdr import SATURATED
from bssrdf.measure.session import measure_session
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


def rows_read(monkeypatch):
    """The rows of each part that are read from then on."""
    read, rows = HdrExr.rows, set()

    def watched(self, part, low, high):
        rows.update((part, row) for row in range(low, high))
        return read(self, part, low, high)

    monkeypatch.setattr(HdrExr, "rows", watched)
    return rows


def test_a_curve_read_again_needs_the_pixels_near_the_slice_alone(tmp_path, monkeypatch):
    session = write_session(tmp_path / "tall", shape=(2000, 120))
    measure_session(session)
    before = curve_files(session.path / "measured")
    rows = rows_read(monkeypatch)
    measure_session(session, from_hdr=True)
    assert curve_files(session.path / "measured") == before
    assert {part for part, _ in rows} == {"radiance", "variance", "mask"}
    assert len(rows) < 0.5 * 3 * 2000


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
