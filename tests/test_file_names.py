"""What names say: exposures by one grammar, kinds word by word, and what is told instead."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError, UsageError
from bssrdf.session.file_names import exposure_from_name, exposure_from_path, exposure_source, kind_of, seconds_of
from bssrdf.session.frames_csv import read_frames


@pytest.mark.parametrize(
    ("name", "exposure_s"),
    [
        ("d1_disks32cmV2_450nm_25ms_2019-02-08-174802-0004.tif", 0.025),
        ("sample_0.25s_001.dng", 0.25),
        ("sample-3916ms.tif", 3.916),
        ("4s.tif", 4.0),
        ("1.5ms", 0.0015),
        ("a_2.5e-3s", 0.0025),
        ("a_1E-3s", 0.001),
        ("a_4000us", 0.004),
        ("a_250µs", 0.00025),
        ("a_250μs", 0.00025),
        ("a_4 ms", 0.004),
        ("a_4sec", 4.0),
        ("a_exp4ms", 0.004),
        ("a_t=4ms", 0.004),
        ("0,004s", 0.004),
        ("a_2,5ms", 0.0025),
        ("a (250ms)", 0.25),
        ("a_1-250s", 0.004),
        ("a_1_250s", 0.004),
        ("a_1-4s", 0.25),
        ("a_1/250s", 0.004),
        ("frame_2_4s", 4.0),
        ("frame_1_250ms", 0.25),
        ("a_10ms_10ms", 0.01),
        ("frame_1_4s", None),
        ("a_0_004s", None),
        ("a_0-5ms", None),
        ("frame_00_5s", 5.0),
        ("frame-1-4s", None),
        ("a_1,250s", None),
        ("IMG_0001.CR2", None),
        ("sample_10ms_20ms.tif", None),
        ("sample_0ms.tif", None),
        ("sample_5samples.tif", None),
        ("lens50s.tif", None),
        ("20240102s.tif", None),
        ("v2.5ms.tif", None),
        ("v2.5e-3s", None),
        ("a_1.e-3s", None),
        ("tile-3s", 3.0),
        ("a_.5s", 0.5),
        ("a1.5.3s", None),
        ("x0,004s", None),
        ("a_600nm_12h30m10s", None),
    ],
)
def test_exposure_in_a_name(name: str, exposure_s: float | None) -> None:
    assert exposure_from_name(name) == exposure_s


@given(st.floats(1e-6, 1e3), st.sampled_from([("s", 1), ("ms", 1000), ("us", 10**6)]), st.booleans())
def test_a_written_exposure_is_read_whole_or_not_at_all(seconds: float, unit: tuple[str, int], is_comma: bool) -> None:
    number = f"{seconds * unit[1]:.9g}"
    text = number.replace(".", ",") if is_comma else number
    found = exposure_from_name(f"a_{text}{unit[0]}_b")
    assert found is None or found == pytest.approx(seconds, rel=1e-8)
    assert found is not None or "," in text
    assert exposure_from_name(f"a{text}{unit[0]}_b") is None


def test_the_files_name_comes_before_its_folders() -> None:
    assert exposure_from_path(PurePosixPath("250ms/sample/a_1.tif")) == 0.25
    assert exposure_from_path(PurePosixPath("250ms/a_4ms.tif")) == 0.004
    assert exposure_from_path(PurePosixPath("250ms/a_4ms_8ms.tif")) is None
    assert exposure_from_path(PurePosixPath("1/250s.tif")) == 250.0


@pytest.mark.parametrize(
    ("text", "unit", "seconds"),
    [("1/250", "s", 0.004), ("4", "ms", 0.004), ("2.5e3", "us", 0.0025), ("1/250 s", "s", 0.004), ("4 ms", "s", 0.004)],
)
def test_an_exposure_by_itself(text: str, unit: str, seconds: float) -> None:
    assert seconds_of(text, unit) == pytest.approx(seconds, rel=1e-12)
    assert seconds_of(f"x{text}") is None
    assert seconds_of("0") is None


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("sample/dark_chocolate_250ms.dng", "sample"),
        ("reference/dark/a.tif", "dark"),
        ("sample_dark/a.tif", "sample_dark"),
        ("Darks/a.tif", "dark"),
        ("sample/dark room/a.tif", "sample"),
        ("a_sample_dark_4ms.tif", "sample_dark"),
        ("x-dark_1s.tif", "dark"),
        ("sample hdr.exr", "sample_hdr"),
        ("flat-dark/a.tif", "flat_dark"),
        ("samples 2024/a.tif", "sample"),
        ("sample/dark/a.tif", "dark"),
        ("wax/a.tif", None),
        ("sampled/a.tif", None),
        ("a_sample_vs_reference.tif", None),
        ("reference_tile_dark.tif", None),
        ("x_sample/dark_y.tif", "sample"),
    ],
)
def test_kind_by_the_words_of_a_path(path: str, kind: str | None) -> None:
    assert kind_of(PurePosixPath(path), []) == kind


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for kind in ("sample", "dark"):
        (tmp_path / "in" / kind).mkdir(parents=True)
        for number in (1, 2):
            tifffile.imwrite(
                tmp_path / "in" / kind / f"{kind}{number}_t{4000 * number}.tif", np.eye(5, dtype=np.uint16)
            )
    return tmp_path / "in"


@pytest.mark.parametrize("source", [r"_t(?P<us>\d+)", "times.csv"])
def test_exposures_are_told_by_an_expression_or_a_table(folder: Path, tmp_path: Path, source: str) -> None:
    (tmp_path / "times.csv").write_text(
        "file,exposure_s\nsample1_t4000.tif,1/250\ndark/dark1_t4000.tif,4 ms\n"
        "sample/sample2_t8000.tif,8e-3\ndark2_t8000.tif,8000us\n"
    )
    told = str(tmp_path / source) if source.endswith("csv") else source
    assert run(cli, ["ingest", str(folder), "--out", str(tmp_path / "s"), "--exposure-from", told]) == 0
    assert [frame.exposure_s for frame in read_frames(tmp_path / "s")] == [0.004, 0.008, 0.004, 0.008]


@pytest.mark.parametrize(
    ("source", "code"), [("_t(", 2), ("_t", 2), ("(?P<min>1)", 2), ("_x(.*)", 3), ("(sample)", 3), ("none.csv", 3)]
)
def test_a_source_that_tells_nothing_is_refused(folder: Path, tmp_path: Path, source: str, code: int) -> None:
    with pytest.raises((UsageError, InputError)) as caught:
        exposure_source(source, folder)(PurePosixPath("sample/sample1_t4000.tif"), 0)
    assert caught.value.exit_code == code
    assert run(cli, ["ingest", str(folder), "--out", str(tmp_path / "s"), "--exposure-from", source]) == code
    assert not (tmp_path / "s").exists()


def test_a_table_without_the_file_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "times.csv").write_text("file,exposure_s\nsample1_t4000.tif,0.004\n")
    with pytest.raises(InputError, match="has no line for sample/sample2_t8000"):
        exposure_source(str(tmp_path / "times.csv"), folder)(PurePosixPath("sample/sample2_t8000.tif"), 0)
    (tmp_path / "times.csv").write_text("file,exposure_s\nsample1_t4000.tif,fast\n")
    with pytest.raises(InputError, match="line 2: exposure_s 'fast' must be a time"):
        exposure_source(str(tmp_path / "times.csv"), folder)
