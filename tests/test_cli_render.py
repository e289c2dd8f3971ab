"""`bssrdf render`, `compare` and `doctor` as a user meets them: pictures, provenance, one line for what is wrong."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.session.oiio_file import read_images

QUICK = ("--quiet", "--width", "12", "--samples", "2", "--quality", "draft")


needs_renderer = pytest.mark.usefixtures("renderer")


def bssrdf(*arguments: object) -> int:
    return run(cli, [str(argument) for argument in arguments])


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = [text for text in capsys.readouterr().err.splitlines() if text.startswith("bssrdf:")]
    return line


@needs_renderer
def test_a_picture_is_written_with_what_made_it_and_never_over_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ("render", "block", "--model", "bssrdf", "--seed", "3", "--out", tmp_path / "cube", *QUICK)
    assert bssrdf(*command) == 0
    parts = {image.name: image for image in read_images(tmp_path / "cube.exr")}
    assert parts["radiance"].data.shape == (12, 12, 3)
    assert np.isfinite(parts["radiance"].data).all()
    assert parts["radiance"].data.max() > 0
    assert (parts["variance"].data >= 0).all()
    facts = json.loads(parts["radiance"].attributes["bssrdf:provenance"])
    assert (facts["scene"], facts["seed"], facts["options"]["model"]) == ("block", 3, "bssrdf")
    assert facts["materials"]["block"]["sigma_sp"] == [2.19, 2.62, 3.0]
    (shown,) = read_images(tmp_path / "cube.png")
    assert json.loads(shown.attributes["bssrdf:provenance"])["exposure"] > 0
    capsys.readouterr()
    assert bssrdf(*command) == 2
    assert "exists already" in one_line(capsys)
    assert bssrdf(*command, "--force") == 0
    assert {path.name for path in tmp_path.iterdir()} == {"cube.exr", "cube.png"}


@needs_renderer
def test_a_picture_may_be_named_by_either_of_its_files(tmp_path: Path) -> None:
    assert bssrdf("render", "block", "--model", "brdf", "--out", tmp_path / "cube.png", *QUICK) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"cube.exr", "cube.png"}


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="no folder that nobody can write to")
@pytest.mark.parametrize(("folder", "words"), [("/proc", "cannot be written to"), ("/proc/none", "is not a folder")])
def test_a_picture_that_could_not_be_written_is_not_drawn(
    folder: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bssrdf("render", "bust", "--out", f"{folder}/bust") == 2
    assert words in one_line(capsys)


@needs_renderer
def test_a_scene_file_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf("render", tmp_path / "none.xml", "--out", tmp_path / "none") == 3
    assert one_line(capsys).endswith("none.xml: is not there; check the path")


@needs_renderer
def test_a_picture_is_drawn_without_jax_once_its_kernels_are_known(tmp_path: Path) -> None:
    command = ["render", "bust", "--method", "points", "--out", str(tmp_path / "bust"), "--force", *QUICK]
    assert bssrdf(*command) == 0  # makes them
    code = """
import sys
from bssrdf.cli import cli
from bssrdf.commands.console import run
assert run(cli, sys.argv[1:]) == 0
assert "jax" not in sys.modules, "JAX takes as long to start as Mitsuba does"
"""
    done = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@needs_renderer
def test_the_same_seed_gives_the_same_picture(tmp_path: Path) -> None:
    for name in "ab":
        assert bssrdf("render", "texture", "--model", "brdf", "--out", tmp_path / name, *QUICK) == 0
    first, second = (read_images(tmp_path / f"{name}.exr")[0].data for name in "ab")
    np.testing.assert_array_equal(first, second)


@needs_renderer
def test_terms_of_the_dipole_add_up_to_the_picture(tmp_path: Path) -> None:
    means = {}
    for terms in ("diffusion", "single", "specular", "diffusion,single,specular"):
        options = ("--light", "sky", "--model", "brdf", "--kernel", "dipole", "--width", "16", "--samples", "64")
        assert bssrdf("render", "slab", "--terms", terms, "--out", tmp_path / terms, *options, "--quiet") == 0
        means[terms] = read_images(tmp_path / f"{terms}.exr")[0].data.mean()
    *apart, whole = means.values()
    assert whole == pytest.approx(sum(apart), rel=0.02)


@needs_renderer
def test_auto_says_what_it_chose_and_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--width", "12", "--samples", "2", "--quality", "draft")
    assert bssrdf("render", "block", "--explain", "--out", tmp_path / "cube", *options) == 0
    said = capsys.readouterr().err
    assert "--method auto finds the light" in said
    assert "auto: bssrdf (light spreads" in said
    assert "auto: points (block: under a narrow beam" in said


@needs_renderer
def test_a_picture_says_how_long_it_will_take_and_stops_at_its_noise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--width", "24", "--method", "points", "--quality", "draft", "--out", tmp_path / "bust")
    assert bssrdf("render", "bust", *options) == 0
    said = capsys.readouterr()
    assert re.search(r"prepared in [\d.]+ s; noise [\d.]+% after \d+ samples per pixel", said.err)
    noise = re.search(r"noise ([\d.]+)%, ", said.out)
    assert noise is not None
    assert float(noise[1]) <= 6.0


@needs_renderer
def test_a_time_is_used_and_hardly_exceeded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    began = time.perf_counter()
    options = ("--width", "12", "--model", "brdf", "--time", "4s", "--quiet", "--out", tmp_path / "bust")
    assert bssrdf("render", "bust", *options) == 0
    assert time.perf_counter() - began > 3.0
    counted = re.search(r"brdf: (\d+) samples", capsys.readouterr().out)
    assert counted is not None
    assert int(counted[1]) > 8


@needs_renderer
def test_compare_scores_every_model_against_monte_carlo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--light", "sky", "--mc-depth", "60", "--out", tmp_path / "slab", *QUICK)
    assert bssrdf("compare", "slab", *options) == 0
    scores = json.loads((tmp_path / "slab" / "compare.json").read_text())["scores"]
    assert [score["model"] for score in scores] == ["brdf", "bssrdf", "mc"]
    assert scores[-1]["mean_ratio"] == 1
    assert all(score["seconds"] > 0 for score in scores)
    assert {"compare.png", "brdf.exr", "bssrdf.png", "mc.exr"} <= {path.name for path in (tmp_path / "slab").iterdir()}
    assert "| mc |" in capsys.readouterr().out
    assert bssrdf("compare", "slab", *options) == 2


@needs_renderer
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("bunny",), 2, 'no scene "bunny"'),
        (("block", "--material", "marbel"), 3, "not in the published table"),
        (("block", "--material", "none.json"), 3, "none.json"),
        (("block", "--light", "sky"), 2, "takes no light"),
        (("texture", "--texture", "none.png"), 3, "no such texture"),
        (("bust", "--mesh", "none.ply"), 3, "is not there"),
        (("bust", "--mesh", "none.stl"), 3, "convert it"),
        (("bust", "--height-mm", "10"), 2, "--mesh"),
        (("block", "--model", "mc"), 2, "narrow light"),
        (("block", "--terms", "shiny"), 2, 'term "shiny"'),
        (("block", "--terms", "single"), 2, "add --kernel dipole"),
        (("block", "--paper"), 2, "add --kernel dipole"),
        (("block", "--sampling", "exact"), 2, "--method"),
        (("block", "--time", "5s", "--samples", "4"), 2, "give one"),
        (("none.xml",), 3, "none.xml"),
    ],
)
def test_what_is_wrong_with_a_scene_is_one_line(
    arguments: tuple[str, ...],
    code: int,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert bssrdf("render", *arguments, "--quiet", "--out", "picture") == code
    assert words in one_line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_an_option_that_a_file_does_not_take_is_named_as_it_was_typed(capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf("render", "some.xml", "--width", "8") == 2
    assert one_line(capsys).endswith("leave out --width")


def test_a_misspelt_option_is_told_a_living_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf("render", "block", "--samplng", "8") == 2
    said = capsys.readouterr().err
    assert "--samples" in said
    assert "--sampling" not in said


XML = """<scene version="3.0.0">
<sensor type="perspective"><transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
<shape type="sphere"><bsdf type="bssrdf_medium">{surface}<float name="eta" value="1.3"/></bsdf></shape>{rest}</scene>"""
WAX = '<float name="sigma_a" value="0.1"/><float name="sigma_sp" value="20"/>'
LAMP = '<emitter type="constant"/>'
LOST = '<texture name="sigma_a" type="bitmap"><string name="filename" value="lost.exr"/></texture>'


@needs_renderer
def test_a_mitsuba_file_is_rendered(tmp_path: Path) -> None:
    (tmp_path / "wax.xml").write_text(XML.format(surface=WAX, rest=LAMP))
    assert bssrdf("render", tmp_path / "wax.xml", "--out", tmp_path / "wax", "--quiet", "--samples", "2") == 0
    assert read_images(tmp_path / "wax.exr")[0].data[4, 4].min() > 0


@needs_renderer
@pytest.mark.parametrize(
    ("surface", "rest", "words"),
    [(WAX, "", "has no light"), (LOST, LAMP, "lost.exr"), ('<float name="sigma_x" value="1"/>', LAMP, "sigma_")],
)
def test_what_is_wrong_with_a_mitsuba_file_is_one_line(
    surface: str, rest: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.xml").write_text(XML.format(surface=surface, rest=rest))
    assert bssrdf("render", tmp_path / "bad.xml", "--out", tmp_path / "bad", "--quiet") == 3
    line = one_line(capsys)
    assert words in line
    assert "bad.xml" in line


TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face {n}
property list uchar int vertex_indices
end_header
0 0 0
{size} 0 0
0 {size} 0
0 0 {size}
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""


@needs_renderer
def test_a_mesh_without_normals_or_too_small_for_its_medium_is_remarked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bit.ply").write_text(TETRAHEDRON.format(n=4, size=0.2))
    options = ("--model", "bssrdf", "--out", tmp_path / "bit", *QUICK)
    assert bssrdf("render", "bust", "--mesh", tmp_path / "bit.ply", *options) == 0
    said = capsys.readouterr().err
    assert "has no normals" in said
    assert "0.456 mm, and the body is 0.0423 mm large" in said


@needs_renderer
def test_an_open_mesh_is_remarked_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "open.ply").write_text(TETRAHEDRON.format(n=3, size=40).replace("3 1 2 3\n", ""))
    options = ("--model", "bssrdf", "--out", tmp_path / "open", *QUICK)
    assert bssrdf("render", "bust", "--mesh", tmp_path / "open.ply", *options) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "is open" in line]
    assert len(said) == 1
    assert said[0].startswith("bssrdf:")


def test_doctor_lists_libraries_and_what_renders(capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf("doctor", "--quiet") == 0
    said = capsys.readouterr().out
    assert {"Python", "numpy", "rendering", "GPU", "devices"} <= {line.split()[0] for line in said.splitlines()}


def test_doctor_says_what_to_install(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("bssrdf.report.doctor.find_backend", lambda: None)
    assert bssrdf("doctor", "--quiet") == 0
    assert "libllvm19" in capsys.readouterr().out
