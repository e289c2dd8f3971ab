"""The report agrees with the files it rests on, opens anywhere, and runs nothing that a name holds."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import chromium, show
from filmed import edit, film, marble

from bssrdf.bench.frame_faults import Shown, write_session
from bssrdf.calib import Surface
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.measure.hdr import Hdr
from bssrdf.measure.scene import on_image
from bssrdf.measure.session import measure_session
from bssrdf.report.evidence import gather
from bssrdf.report.halves import halves
from bssrdf.report.left_out import left_out
from bssrdf.report.page import GENERATOR
from bssrdf.report.swatches import Swatch, swatch
from bssrdf.report.tiles import halves_tile, noise_tile
from bssrdf.report.verdict import verdict_of
from bssrdf.session.fit_json import read_fit, write_fit
from bssrdf.session.frames_csv import read_frames, write_frames
from bssrdf.session.hdr_image import read_hdr_exr
from bssrdf.session.records import ChannelSlice, Colour, Geometry, Slice
from bssrdf.session.slice_csv import write_slice

MOST_BYTES = 1_500_000
AWKWARD = 'a "quoted" <b>name</b></script>\n& more'


def bssrdf(*arguments: object) -> int:
    return run(cli, [*map(str, arguments), "--quiet"])


class Page(HTMLParser):
    """Text by `data-answer`, attributes of marked elements, and how often each tag was opened."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.answers: dict[str, str] = {}
        self.marked: list[dict[str, str | None]] = []
        self.tags: dict[str, int] = {}
        self._open: list[tuple[str, str | None]] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags[tag] = self.tags.get(tag, 0) + 1
        if "data-channel" in found:
            self.marked.append(found)
        if tag not in ("meta", "link", "br", "image", "line", "rect", "polygon", "polyline", "path"):
            self._open.append((tag, found.get("data-answer")))

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop()[0] != tag:
            pass

    def handle_data(self, data: str) -> None:
        for _, answer in self._open:
            if answer:
                self.answers[answer] = self.answers.get(answer, "") + data


@lru_cache
def report_on(path: Path, *more: object) -> Page:
    """The page on a session, or on a fit with `--out`; made once."""
    assert bssrdf("report", path, *more) == 0
    html = (path / "report.html" if path.is_dir() else Path(str(more[1]))).read_text(encoding="utf-8")
    assert len(html.encode()) < MOST_BYTES
    return Page(html)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, scene = tmp_path_factory.mktemp("report"), marble()
    film(scene, folder / "photos")
    kinds = [f"--kind={name}/*={kind}" for name, kind in (("stone", "sample"), ("tile", "reference"), ("dark", "dark"))]
    assert bssrdf("ingest", folder / "photos", "--out", folder / "good", *kinds) == 0
    edit(folder / "good" / "session.toml", scene)
    assert bssrdf("measure", folder / "good") == 0
    assert bssrdf("fit", folder / "good") == 0
    return folder / "good"


def copy(session: Path, name: str) -> Path:
    shutil.copytree(session, session.parent / name)
    return session.parent / name


@pytest.fixture(scope="module")
def rejected(good: Path) -> Path:
    """The tile's reflectance is stated too low by a sixth: R and curve contradict each other."""
    session = copy(good, "rejected")
    file = session / "session.toml"
    text = file.read_text(encoding="utf-8")
    lines = [
        ("reflectance = [0.85, 0.85, 0.85]" if line.startswith("reflectance = ") else line) for line in text.split("\n")
    ]
    file.write_text("\n".join(lines), encoding="utf-8")
    assert bssrdf("measure", session, "--from-hdr") == 0
    assert bssrdf("fit", session) == 0
    return session


@pytest.fixture(scope="module")
def clipped(good: Path) -> Path:
    """The shortest exposures of the sample are lost."""
    session = copy(good, "clipped")
    frames = [frame for frame in read_frames(session) if frame.kind != "sample" or frame.exposure_s > 0.2]
    write_frames(session, frames)
    assert bssrdf("measure", session) == 0
    assert bssrdf("fit", session) == 0
    return session


def curve_of(channels: tuple[str, ...], *, material: str | None = None, shared: str | None = None) -> Slice:
    r = np.geomspace(0.5, 15, 40)
    parts = {}
    for at, name in enumerate(channels):
        rd = 0.1 * np.exp(-r * (0.3 + 0.02 * at)) / r**2
        parts[name] = ChannelSlice(r, rd, 0.02 * rd)
    totals = dict.fromkeys(channels, 0.5)
    return Slice(parts, 1.4, "entering", "hemisphere", total_r=totals, total_r_sd=dict.fromkeys(channels, 0.2),
                 material=material, g=0.8, scale_rel_sd=0.1, shared_errors=shared)  # fmt: skip


@pytest.fixture(scope="module")
def lone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Fits without a session: of a mono camera with an awkward name, of 12 bands, of two slices together."""
    folder = tmp_path_factory.mktemp("lone")
    bands = tuple(f"{nm}nm" for nm in range(420, 684, 24))
    pieces = {"mono": curve_of(("633nm",), material=AWKWARD), "bands": curve_of((*bands, "684nm"))}
    pieces |= {name: curve_of(("R", "G"), shared="tile") for name in ("one", "two")}
    for name, piece in pieces.items():
        write_slice(folder / f"{name}.csv", piece)
    for name, inputs in (("mono", ["mono"]), ("bands", ["bands"]), ("joint", ["one", "two"])):
        joint = ["--joint"] if len(inputs) > 1 else []
        paths = [folder / f"{each}.csv" for each in inputs]
        assert bssrdf("fit", *paths, *joint, "--model", "mc", "--out", folder / f"{name}.json") == 0
    return {name: folder / f"{name}.json" for name in ("mono", "bands", "joint")}


def channels_of(session: Path) -> dict[str, Any]:
    fit: dict[str, Any] = json.loads((session / "fit.json").read_text(encoding="utf-8"))
    return fit["channels"]


@pytest.mark.parametrize("name", ["good", "rejected", "clipped"])
def test_answers_are_those_of_the_fit(name: str, request: pytest.FixtureRequest) -> None:
    session: Path = request.getfixturevalue(name)
    page, channels = report_on(session), channels_of(session)
    assert set(page.answers) == {"trusted", "limits", "slice", "saturated", "better"}
    trust = {str(row["data-channel"]): row["data-trust"] for row in page.marked if "data-trust" in row}
    assert set(trust) == set(channels)
    for channel, found in channels.items():
        assert (trust[channel] == "no") == (found["status"] in ("rejected", "unidentifiable", "failed"))
    limits = {str(mark["data-channel"]): mark for mark in page.marked if "data-source" in mark}
    for channel, found in channels.items():
        shares = found["budget"]["sigma_a"]
        assert (channel in limits) == bool(shares)
        if shares:
            source = max(shares, key=lambda key: shares[key])
            assert limits[channel]["data-source"] == source
            assert float(str(limits[channel]["data-share"])) == pytest.approx(shares[source], abs=1e-4)


def test_verdicts_differ_as_the_sessions_do(good: Path, rejected: Path, clipped: Path) -> None:
    said = {path.name: verdict_of(read_fit(path / "fit.json")) for path in (good, rejected, clipped)}
    assert set(said["good"].trust.values()) == {"yes"}
    assert "no" in said["rejected"].trust.values()
    assert "yes" not in said["rejected"].trust.values()
    assert set(said["clipped"].trust.values()) == {"care"}
    assert any("shorter exposures" in advice for advice in said["clipped"].advice)


def test_saturated_pixels_and_the_slice_are_those_of_the_images(good: Path, clipped: Path) -> None:
    mask = read_hdr_exr(clipped / "measured" / "sample.exr")[0]["mask"].astype(int)
    page = report_on(clipped)
    for channel, corner in (("R", (0, 0)), ("B", (1, 1))):
        count = int(np.count_nonzero(mask[corner[0] :: 2, corner[1] :: 2] & 1))
        assert count
        assert f"{count} px of {channel} in the sample" in page.answers["saturated"]
    assert "nothing" in report_on(good).answers["saturated"]
    y, x = np.unravel_index(np.argmax(read_hdr_exr(good / "measured" / "sample.exr")[0]["radiance"]), mask.shape)
    spot = report_on(good).answers["slice"].split("spot at (")[1].split(")")[0]
    assert np.hypot(*(np.array(spot.split(","), float) - (x, y))) < 3


def test_saturated_pixels_are_red_in_the_scene(good: Path, clipped: Path) -> None:
    red = {}
    for session in (good, clipped):
        drawn = cv2.imread(str(session / "measured" / "scene.png"))
        assert drawn is not None
        where = np.argwhere((drawn[120:, :900] == (48, 59, 255)).all(axis=2))
        red[session.name] = where + np.array([120, 0])
    assert not len(red["good"])
    spot = np.array(report_on(clipped).answers["slice"].split("spot at (")[1].split(")")[0].split(","), float)
    assert np.hypot(*(red["clipped"].mean(axis=0)[::-1] * 400 / 900 - spot)) < 4


def test_image_points_are_found_from_the_surface() -> None:
    geometry = Geometry(homography=((0.05, 0.004, 1.0), (0.002, 0.07, 2.0), (1e-5, 2e-5, 1.0)), view_angle_deg=40.0)
    surface, centre = Surface(geometry), (200.3, 120.7)
    across, along = np.array([-5.0, 0.0, 7.0]), np.array([3.0, -2.0, 0.5])
    points = on_image(surface, centre, across, along)
    assert np.allclose(surface.centred(points[:, 0], points[:, 1], centre), [across, along], atol=1e-9)


def test_a_half_that_differs_is_found(good: Path) -> None:
    evidence = gather(good)
    assert evidence.fit
    piece, found = evidence.pieces[0].curve, evidence.fit.channels["G"]
    honest = halves(piece, "G", found, evidence.fit.options)
    assert not isinstance(honest, str)
    assert all(half.agrees for half in honest)
    part = piece.channels["G"]
    assert part.side is not None
    brighter = replace(part, rd_per_mm2=part.rd_per_mm2 * np.where(part.side > 0, 1.08, 1.0))
    tampered = halves(replace(piece, channels={"G": brighter}), "G", found, evidence.fit.options)
    assert not isinstance(tampered, str)
    assert halves_tile(tampered).holds is False
    left, _ = tampered
    assert left.departure == pytest.approx(0.08, abs=0.03)


def test_a_wrong_exposure_is_found_by_the_others(good: Path) -> None:
    evidence = gather(good)
    assert evidence.session
    assert evidence.merged
    provenance = evidence.merged.provenance
    honest = left_out(evidence.session, evidence.frames, provenance)
    assert not isinstance(honest, str)
    assert len(honest) > 8
    assert all(each.holds for each in honest)
    seconds = list(provenance["exposures_s"]["sample"])
    seconds[4] *= 1.06
    wrong = provenance | {"exposures_s": provenance["exposures_s"] | {"sample": seconds}}
    found = left_out(evidence.session, evidence.frames, wrong)
    assert not isinstance(found, str)
    worst = max(found, key=lambda each: abs(each.departure))
    assert (worst.kind, round(worst.exposure_s, 3)) == ("sample", 0.25)
    assert worst.departure == pytest.approx(1 / 1.06 - 1, abs=0.01)


def test_black_that_the_merge_took_off_is_taken_off_before_a_frame_is_predicted(tmp_path: Path) -> None:
    session = write_session(tmp_path / "s", raised, seed=3)
    provenance = measure_session(session, hdr_only=True).provenance
    frames = read_frames(session.path)
    taken_off = left_out(session, frames, provenance)
    left_in = left_out(session, frames, provenance | {"corrections": {}})
    assert not isinstance(taken_off, str)
    assert not isinstance(left_in, str)
    assert all(each.holds for each in taken_off)
    assert not all(each.holds for each in left_in)


def raised(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    return [replace(each, black_dn=12.0) if each.kind == "sample" else each for each in frames]


def test_noise_above_its_bound_is_found(good: Path) -> None:
    from bssrdf.report.page import _noise

    evidence = gather(good)
    assert evidence.merged
    honest = _noise(evidence)
    assert noise_tile(honest).holds
    images = evidence.merged.images
    louder = {kind: Hdr(hdr.radiance, 4 * hdr.variance, hdr.count, hdr.mask) for kind, hdr in images.items()}
    found = _noise(replace(evidence, merged=replace(evidence.merged, images=louder)))
    assert noise_tile(found).holds is False


def test_what_is_not_there_is_said_in_its_place(good: Path) -> None:
    session = copy(good, "bare")
    (session / "fit.json").unlink()
    assert "bssrdf fit" in report_on.__wrapped__(session).answers["trusted"]
    for kind in ("sample", "reference"):
        (session / "measured" / f"{kind}.exr").unlink()
    assert "no HDR image" in report_on.__wrapped__(session).answers["slice"]
    shutil.rmtree(session / "measured")
    shutil.rmtree(session / "frames")
    assert "bssrdf measure" in report_on.__wrapped__(session).answers["better"]


def test_what_is_broken_is_refused(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = copy(good, "broken")
    (session / "measured" / "sample.exr").write_bytes(b"no image")
    assert bssrdf("report", session) == 3
    assert "sample.exr" in capsys.readouterr().err
    (session / "fit.json").write_text("{")
    assert bssrdf("report", session) == 3
    assert "fit.json" in capsys.readouterr().err
    assert bssrdf("report", good.parent / "photos") == 3
    assert bssrdf("report", good.parent / "nowhere") == 3
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_a_report_of_ours_is_replaced_and_nothing_else(good: Path, lone: dict[str, Path], tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    assert bssrdf("report", lone["mono"]) == 2
    target.write_text("<p>mine</p>")
    assert bssrdf("report", lone["mono"], "--out", target) == 2
    assert target.read_text() == "<p>mine</p>"
    assert bssrdf("report", lone["mono"], "--out", target, "--force") == 0
    assert GENERATOR in target.read_text(encoding="utf-8")
    assert bssrdf("report", lone["mono"], "--out", target) == 0


def test_names_from_files_are_escaped(lone: dict[str, Path], tmp_path: Path) -> None:
    plain, awkward = tmp_path / "plain.json", tmp_path / "awkward.json"
    fit = read_fit(lone["mono"])
    write_fit(plain, replace(fit, material="plain"))
    renamed = {f"<i>{name}</i>": channel for name, channel in fit.channels.items()}
    write_fit(awkward, replace(fit, material=AWKWARD, channels=renamed, options=fit.options | {"material": AWKWARD}))
    expected = report_on(plain, "--out", tmp_path / "plain.html")
    found = report_on(awkward, "--out", tmp_path / "awkward.html")
    for tag in ("i", "script", "h1"):
        assert found.tags.get(tag, 0) <= expected.tags.get(tag, 0)
    html = (tmp_path / "awkward.html").read_text(encoding="utf-8")
    assert "<b>name</b>" not in html
    assert "<i>633nm" not in html
    assert AWKWARD not in html


def test_a_white_is_shown_white_where_there_is_a_colour_space() -> None:
    bands = {f"{nm}nm": 1.0 for nm in range(400, 720, 20)}
    shown = swatch(bands, None)
    assert isinstance(shown, Swatch)
    assert min(int(shown.srgb[at : at + 2], 16) for at in (1, 3, 5)) >= 253
    unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    grey = swatch(dict.fromkeys("RGB", 0.2159), Colour(unit))
    assert isinstance(grey, Swatch)
    assert grey.srgb == "#808080"
    assert "no [colour]" in str(swatch(dict.fromkeys("RGB", 0.5), None))
    assert "no swatch" in str(swatch({"633nm": 0.5}, None))


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with chromium() as one:
        yield one


@pytest.mark.parametrize("name", ["good", "rejected", "clipped", "mono", "bands", "joint"])
def test_pages_open_without_a_fault_at_any_width(
    name: str, driver: Any, lone: dict[str, Path], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    if name in lone:
        page, html = report_on(lone[name], "--out", tmp_path / "report.html"), tmp_path / "report.html"
    else:
        session: Path = request.getfixturevalue(name)
        page, html = report_on(session), session / "report.html"
    for width, dark, media in (
        (1400, False, "screen"),
        (375, False, "screen"),
        (1400, True, "screen"),
        (800, False, "print"),
    ):
        show(driver, html, width=width, dark=dark, media=media)
        assert driver.get_log("browser") == []
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        drawn, panels = driver.execute_script(
            "return [document.querySelectorAll('.uplot').length, document.querySelectorAll('figure.panel').length]"
        )
        assert drawn == 2 * panels > 0 or name == "rejected"  # without coefficients the printed figure may stay
        back = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert (back == "rgb(255, 255, 255)") != dark
        printed = driver.execute_script(
            "return document.querySelector('figure.panel > svg').getBoundingClientRect().height"
        )
        assert (printed > 0) == (media == "print") or name == "rejected"
    assert page.tags["figure"] >= panels
