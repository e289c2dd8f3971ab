"""frames.csv as a table and as a journal."""

from __future__ import annotations

import string
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bssrdf.errors import InputError
from bssrdf.session.frames_csv import append_frame, dark_for, read_frames, recover_frames, write_frames
from bssrdf.session.records import KINDS, Card, Frame

CARD = Card(
    "Nikon D850", "50mm f/1.8", 100.0, 1.5, 8.0, 50.0, -5.0, "RGGB", 14, (512.0, 513.5, 512.0, 512.0), (16383.0,)
)
FULL = Frame("frames/a, b.tif", "sample", 0.1, 0.1000017, "2001-08-12T10:00:00Z", "0f" * 32, 0.001, CARD)
SHORT = Frame("frames/c.tif", "sample_dark", 1 / 3)
EXPOSURES = st.floats(1e-6, 1e4)
NAMES = st.none() | st.text(string.ascii_letters + ' ,"/', min_size=1).map(lambda name: f"x{name}x")
POSITIVE = st.none() | EXPOSURES
CARDS = st.builds(
    Card,
    camera=NAMES,
    lens=NAMES,
    iso=POSITIVE,
    gain=st.none() | st.floats(-10, 100),
    f_number=POSITIVE,
    temperature_c=st.none() | st.floats(-80, 80),
    bits=st.none() | st.integers(1, 32),
    black=st.none() | st.tuples(EXPOSURES) | st.tuples(*[EXPOSURES] * 4),
    width_px=st.none() | st.integers(1, 10**5),
)
FRAMES = st.lists(
    st.builds(
        Frame,
        file=st.text(string.ascii_letters + ' ,"', min_size=1).map(lambda name: f"frames/{name}.tif"),
        kind=st.sampled_from(KINDS),
        exposure_s=EXPOSURES,
        exposure_measured_s=st.none() | EXPOSURES,
        utc=st.none() | st.just("2001-08-12T10:00:00+00:00"),
        sha256=st.none() | st.just("ab" * 32),
        exposure_rel_sd=POSITIVE,
        card=CARDS,
    ),
    min_size=1,
    max_size=5,
    unique_by=lambda frame: frame.file,
)


@settings(max_examples=50, deadline=None)
@given(frames=FRAMES)
def test_written_frames_are_read_back(tmp_path_factory: pytest.TempPathFactory, frames: list[Frame]) -> None:
    session = tmp_path_factory.mktemp("s")
    write_frames(session, frames)
    assert read_frames(session, must_exist=False) == frames
    assert [file.name for file in session.iterdir()] == ["frames.csv"]


@pytest.mark.parametrize(
    ("column", "text", "wanted"),
    [
        ("iso", "auto", "a finite number > 0"),
        ("exposure_rel_sd", "0", "a finite number > 0"),
        ("temperature_c", "nan", "a finite number"),
        ("bits", "12.5", "a whole number"),
        ("black", "1 2", "one number, or one for each place"),
    ],
)
def test_a_card_that_cannot_be_is_refused(tmp_path: Path, column: str, text: str, wanted: str) -> None:
    (tmp_path / "frames.csv").write_text(f"file,kind,exposure_s,{column}\na.tif,sample,1,{text}\n")
    with pytest.raises(InputError, match=f"line 2: {column} '{text}' must be {wanted}"):
        read_frames(tmp_path, must_exist=False)


def test_columns_that_no_frame_fills_are_left_out(tmp_path: Path) -> None:
    write_frames(tmp_path, [SHORT])
    assert (tmp_path / "frames.csv").read_text() == f"file,kind,exposure_s\nframes/c.tif,sample_dark,{1 / 3!r}\n"


def test_journal_only_grows(tmp_path: Path) -> None:
    written = ""
    for frame in (FULL, SHORT):
        append_frame(tmp_path, frame)
        content = (tmp_path / "frames.csv").read_text()
        assert content.startswith(written)
        assert content.endswith("\n")
        written = content
    assert read_frames(tmp_path, must_exist=False) == [FULL, SHORT]


def test_frame_is_appended_in_the_columns_of_a_table_by_hand(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("exposure_s,file,kind\n1,frames/a.tif,sample\n")
    append_frame(tmp_path, SHORT)
    assert recover_frames(tmp_path)[1] == SHORT
    with pytest.raises(InputError, match="no column exposure_measured_s"):
        append_frame(tmp_path, FULL)


def test_recovery_after_a_cut_anywhere_keeps_the_finished_lines(tmp_path: Path) -> None:
    append_frame(tmp_path, FULL)
    append_frame(tmp_path, SHORT)
    content = (tmp_path / "frames.csv").read_bytes()
    ends = [i + 1 for i, byte in enumerate(content) if byte == ord("\n")]
    for cut in range(len(content) + 1):
        (tmp_path / "frames.csv").write_bytes(content[:cut])
        finished = [FULL, SHORT][: max(sum(end <= cut for end in ends) - 1, 0)]
        assert recover_frames(tmp_path) == finished
        append_frame(tmp_path, Frame("frames/next.tif", "sample", 1.0))
        assert [frame.file for frame in recover_frames(tmp_path)] == [*(f.file for f in finished), "frames/next.tif"]


def test_nothing_is_appended_to_an_unfinished_line(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("file,kind,exposure_s\nframes/a.tif,sample,0.")
    with pytest.raises(InputError, match="not finished"):
        append_frame(tmp_path, SHORT)


def test_recovery_without_a_journal_is_empty(tmp_path: Path) -> None:
    assert recover_frames(tmp_path) == []


def test_table_from_a_spreadsheet_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.tif").touch()
    (tmp_path / "frames.csv").write_bytes(b"\xef\xbb\xbffile, kind, exposure_s\r\na.tif, sample, 0.5\r\n\r\n")
    assert read_frames(tmp_path) == [Frame("a.tif", "sample", 0.5)]


def test_link_that_stays_inside_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real.tif").touch()
    (tmp_path / "link.tif").symlink_to(tmp_path / "real.tif")
    (tmp_path / "frames.csv").write_text("file,kind,exposure_s\nlink.tif,sample,1\n")
    assert read_frames(tmp_path)[0].file == "link.tif"


def test_dark_is_of_the_frames_own_kind_and_exposure() -> None:
    sample, reference = Frame("s.tif", "sample", 0.25), Frame("r.tif", "reference", 0.25)
    own = [Frame(f"d{i}.tif", "sample_dark", exposure) for i, exposure in enumerate((0.25, 0.2502, 0.2498))]
    shared = Frame("e.tif", "dark", 0.25)
    others = [Frame("f.tif", "sample_dark", 0.2506), Frame("g.tif", "flat_dark", 0.25), Frame("h.tif", "dark", 0.5)]
    frames = [sample, reference, *own, shared, *others]
    assert dark_for(sample, frames) == own
    assert dark_for(reference, frames) == [shared]
