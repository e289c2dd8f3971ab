"""plan.toml and rig.toml, and the list of frames that a plan stands for."""

from __future__ import annotations

from pathlib import Path

import pytest

from bssrdf.errors import InputError
from bssrdf.rig.plan_toml import read_plan
from bssrdf.rig.rig_toml import read_rig
from bssrdf.rig.steps import snapped, steps_of

MATERIAL = '[material]\nname = "marble"\neta = 1.5\n'
RIG = """\
[shutter]
driver = "sc10"
port = "/dev/ttyUSB0"
[camera]
driver = "gphoto2"
iso = "100"
white = 16383.0
[geometry]
mm_per_px = 0.05
[reference]
name = "Spectralon"
reflectance = [0.99, 0.99, 0.99]
"""


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "file.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_a_series_is_even_in_stops(tmp_path: Path) -> None:
    plan = read_plan(written(tmp_path, MATERIAL + "[exposures]\nfirst_s = 0.001\nlast_s = 4.096\nsteps_stops = 1\n"))
    assert len(plan.list_s) == 13
    assert plan.list_s[0] == 4.096
    assert plan.list_s[-1] == pytest.approx(0.001)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[exposures]\nauto = true\n", r"lacks the table \[material\]"),
        (MATERIAL, r"lacks the table \[exposures\]"),
        (MATERIAL + "[exposures]\n", "needs one of list_s, auto = true"),
        (MATERIAL + "[exposures]\nauto = true\nlist_s = [1]\n", "needs one of list_s, auto = true"),
        (MATERIAL + "[exposures]\nfirst_s = 1\nlast_s = 2\n", "lacks steps_stops"),
        (MATERIAL + "[exposures]\nlist_s = [0]\n", "list_s = "),
        (MATERIAL + "[exposures]\nlist_s = [nan]\n", "list_s = "),
        (
            '[material]\nname = "x"\n[exposures]\nauto = true\n',
            r"lacks \[material\] eta; add lines such as `\[material\] eta = 1.3`",
        ),
        ('kinds = ["dark"]\n' + MATERIAL + "[exposures]\nauto = true\n", "kinds = "),
        ("format = 2\n" + MATERIAL + "[exposures]\nauto = true\n", "newer than this version"),
        ("kidns = 1\n" + MATERIAL + "[exposures]\nauto = true\n", "did you mean kinds"),
        ("binary \x00 rubbish", "is not TOML"),
    ],
)
def test_a_bad_plan_is_named_with_its_value(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        read_plan(written(tmp_path, text))
    assert "file.toml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_bench_keeps_drivers_and_session_tables_apart(tmp_path: Path) -> None:
    rig = read_rig(written(tmp_path, RIG))
    assert (rig.shutter.driver, rig.shutter.keys) == ("sc10", {"port": "/dev/ttyUSB0"})
    assert (rig.beam.driver, rig.camera.keys) == ("manual", {"iso": "100"})
    assert rig.session_tables["camera"].white == 16383.0
    assert rig.session_tables["reference"].reflectance == (0.99, 0.99, 0.99)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('driver = "sc10"', 'driver = "sc11"', "driver = 'sc11' must be one of command, manual, sc10, scpi, uniblitz"),
        ('port = "/dev/ttyUSB0"', "", "lacks port; the driver sc10 needs it"),
        ('iso = "100"', "isso = 3", "isso is not known; did you mean iso"),
        ("[geometry]\nmm_per_px = 0.05\n", "", r"lacks the table \[geometry\]"),
        ('name = "Spectralon"', "", r"lacks \[reference\] name; add"),
        ("white = 16383.0", "watchdog_s = 3", "watchdog_s is not known"),
    ],
)
def test_a_bad_bench_is_named_with_its_value(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in RIG
    with pytest.raises(InputError, match=message):
        read_rig(written(tmp_path, RIG.replace(old, new)))


def test_exposures_snap_to_the_nearest_stop_and_are_refused_beyond_half_of_one() -> None:
    offered = (0.001, 0.002, 0.004, 0.25)
    assert snapped((0.0011, 0.0039, 0.001), offered) == (0.004, 0.001)
    with pytest.raises(InputError, match=r"exposure 7 s is not one of the camera's: it offers 0.001 to 0.25 s"):
        snapped((7.0,), offered)
    assert snapped((7.0, 1.0), ()) == (7.0, 1.0)


def test_every_frame_has_its_dark_and_drift_frames_come_last(tmp_path: Path) -> None:
    text = "repeats = 2\n" + MATERIAL + "[exposures]\nlist_s = [1, 4]\n"
    plan = read_plan(written(tmp_path, text))
    steps = steps_of(plan, dict.fromkeys(plan.kinds, plan.list_s))
    assert len(steps) == 2 * 2 * 2 * 2 + 2
    assert [step.kind for step in steps[-2:]] == ["reference", "sample"]
    assert {step.exposure_s for step in steps[-2:]} == {4.0}
    for kind in ("sample", "reference"):
        for exposure_s in (1.0, 4.0):
            assert any(step.kind == f"{kind}_dark" and step.exposure_s == exposure_s for step in steps)
    assert len({step.name for step in steps}) == len(steps)


def test_blocks_take_all_frames_before_all_darks(tmp_path: Path) -> None:
    text = 'order = "blocks"\ndrift_check = false\nkinds = ["sample"]\n' + MATERIAL + "[exposures]\nlist_s = [1, 4]\n"
    plan = read_plan(written(tmp_path, text))
    kinds = [step.kind for step in steps_of(plan, {"sample": plan.list_s})]
    assert kinds == ["sample", "sample", "sample_dark", "sample_dark"]
