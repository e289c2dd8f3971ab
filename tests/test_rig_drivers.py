"""Drivers come in by entry points, the project's own and those of other packages alike."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.rig.devices import Devices, devices_of
from bssrdf.rig.drivers import PARTS, Driver, find, names
from bssrdf.rig.rig_toml import read_rig
from bssrdf.rig.scpi import ScpiController

ROOT = Path(__file__).resolve().parents[1]
RIG = """\
[shutter]
driver = "curtain"
rope = 2
[camera]
driver = "command"
expose = "shoot --time {exposure_s} --to {out}"
frame_mb = 12
[geometry]
mm_per_px = 0.05
[reference]
name = "Spectralon"
reflectance = [0.99, 0.99, 0.99]
"""
MODULE = """\
from bssrdf.rig.drivers import Driver
from bssrdf.session.checks import number

class Curtain:
    after_kill = "gravity closes it"
    def __init__(self, clock, rope):
        self.name, self.clock = f"curtain on {rope:g} ropes", clock

DRIVER = Driver({"rope": number(above=0)}, lambda bench, keys: Curtain(bench.clock, **keys), required=("rope",))
OTHER = "no driver"
"""


@pytest.fixture
def rig_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A bench with a shutter of a package that is installed beside the project."""
    (tmp_path / "curtain_rig.py").write_text(MODULE, encoding="utf-8")
    metadata = tmp_path / "curtain_rig-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: curtain-rig\nVersion: 1.0\n", encoding="utf-8")
    declared = {"curtain": "curtain_rig:DRIVER", "other": "curtain_rig:OTHER", "gone": "curtain_rig_gone:DRIVER"}
    points = "".join(f"{name} = {value}\n" for name, value in declared.items())
    (metadata / "entry_points.txt").write_text(f"[bssrdf.shutter]\n{points}sc10 = curtain_rig:OTHER\n", "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    file = tmp_path / "rig.toml"
    file.write_text(RIG, encoding="utf-8")
    return file


def test_a_driver_of_another_package_is_found_and_made(rig_file: Path) -> None:
    devices = devices_of(read_rig(rig_file))
    assert devices.shutter.name == "curtain on 2 ropes"
    assert not devices.by_hand
    assert len(devices.pings) == 1
    assert read_rig(rig_file).frame_mb == 12


def test_the_projects_own_drivers_come_in_by_the_same_door() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    for part in PARTS:
        own = declared[f"bssrdf.{part}"]
        assert set(own) <= set(names(part))
        assert all(isinstance(find(part, name), Driver) for name in own)


def test_a_name_of_the_projects_own_cannot_be_taken_over(rig_file: Path) -> None:
    assert find("shutter", "sc10").required == ("port",)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"curtain"', '"other"', r"driver 'other' of curtain_rig:OTHER is not a bssrdf.rig.drivers.Driver"),
        ('"curtain"', '"gone"', r"driver 'gone' of curtain_rig_gone:DRIVER cannot be loaded \(ModuleNotFoundError"),
        ('"curtain"', '"blind"', "must be one of command, curtain, gone, manual, other, sc10, scpi, uniblitz"),
        ("rope = 2", "rope = 0", "rope = 0 must be a finite number > 0"),
        ("rope = 2", "", "lacks rope; the driver curtain needs it"),
        (" --to {out}", "", r"expose = .* must hold \{exposure_s\} and \{out\}"),
        ('"shoot', "\"'shoot", r"must be a program and its arguments \(no closing quotation\)"),
        ("frame_mb", "overhead_s", "overhead_s is not known"),
    ],
)
def test_a_bad_driver_is_named(rig_file: Path, old: str, new: str, message: str) -> None:
    rig_file.write_text(RIG.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=rf"rig\.toml: \[(shutter|camera)\].*{message}") as error:
        read_rig(rig_file)
    assert "\n" not in str(error.value)


def test_installed_drivers_are_listed(rig_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(cli, ["rig", "list"]) == 0
    assert "drivers for [shutter]: command, curtain, gone, manual, other, sc10" in capsys.readouterr().out


SCPI = """\
[shutter]
driver = "{shutter}"
{shutter_keys}
[beam]
driver = "scpi"
{beam_keys}
[camera]
driver = "command"
expose = "shoot --time {{exposure_s}} --to {{out}}"
[geometry]
mm_per_px = 0.05
[reference]
name = "Spectralon"
reflectance = [0.99, 0.99, 0.99]
"""


def scpi_devices(folder: Path, shutter: str, shutter_keys: str, beam_keys: str) -> Devices:
    file = folder / "rig.toml"
    text = SCPI.format(shutter=shutter, shutter_keys=shutter_keys, beam_keys=beam_keys)
    file.write_text(text, encoding="utf-8")
    return devices_of(read_rig(file))


@pytest.mark.parametrize(
    ("shutter", "keys", "asked"),
    [
        ("scpi", 'port = "/dev/a"', ["/dev/a SHUT:STAT?"]),
        ("scpi", 'port = "/dev/b"', ["/dev/b SHUT:STAT?", "/dev/a BEAM:STAT?"]),
        ("manual", "", ["/dev/a BEAM:STAT?"]),
    ],
)
def test_each_controller_with_a_watchdog_hears_of_us_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shutter: str, keys: str, asked: list[str]
) -> None:
    heard: list[str] = []

    def query(self: ScpiController, command: str, known: Callable[[str], bool]) -> str:
        heard.append(f"{self.name.removeprefix('scpi on ')} {command}")
        return "OPEN" if command.startswith("SHUT") else "ON"

    monkeypatch.setattr(ScpiController, "query", query)
    for ping in scpi_devices(tmp_path, shutter, keys, 'port = "/dev/a"').pings:
        ping()
    assert heard == asked


def test_keys_of_both_parts_make_their_one_controller(tmp_path: Path) -> None:
    devices = scpi_devices(tmp_path, "scpi", 'port = "/dev/a"\nboot_s = 2.0', 'port = "/dev/a"\nwatchdog_s = 9.0')
    controller = devices.shutter._controller  # type: ignore[attr-defined]
    assert controller is devices.beam._controller  # type: ignore[attr-defined]
    assert (controller.watchdog_s, controller._boot_s) == (9.0, 2.0)


def test_one_controller_cannot_have_two_watchdogs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"rig\.toml: \[beam\] watchdog_s = 9\.0 is not the 4\.0 of the other part"):
        scpi_devices(tmp_path, "scpi", 'port = "/dev/a"\nwatchdog_s = 4.0', 'port = "/dev/a"\nwatchdog_s = 9.0')
