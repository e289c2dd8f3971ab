"""Sessions that something is wrong with, each in one way: `python -m bssrdf.bench.sabotage`.

Made on the simulated bench, light walked photon by photon, frames as DNG. None states errors of tile, scale and angle,
as most people do not. A session is caught if measuring refuses it, if a flag names the cause, or if the intervals of
the fit hold the truth.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.measure import measure_session
from bssrdf.rig import (
    BenchScene,
    PictureGeometry,
    SimSensor,
    dng_bytes,
    expose,
    mosaic,
    picture,
    published_sample,
    white_tile,
)
from bssrdf.session import read_session, read_slice, write_frames
from bssrdf.session.records import Frame, FrameKind
from bssrdf.session.text_file import toml_table

Array = NDArray[np.float64]

EXPOSURES_S = (0.001, 0.004, 0.016, 0.064, 0.25, 1.0, 4.0)
_PEAK = 0.1
"""Share of the full well that the brightest pixel fills in the shortest exposure."""
_SPOT_NODES = np.polynomial.hermite_e.hermegauss(5)


@dataclass(frozen=True)
class SabotagedBench:
    """The bench as it is, and, where that differs, as session.toml says it is."""

    material: str = "Marble"
    mm_per_px: float = 0.1
    view_angle_deg: float = 45.0
    view_axis: str = "y"
    spot_mm: float = 0.25
    spot_aspect: float = 1.0
    """Of the beam along the view."""
    fibre: float = 0.0
    """The sample's light reaches farther along the slice, by this share."""
    roll_deg: float = 0.0
    blur_px: dict[str, float] = field(default_factory=dict)
    """Of a camera out of focus, by kind."""
    brightness: float = 1.0
    shift_px: float = 0.0
    """Of the sample in the later half of its bracket."""
    centre_px: dict[str, tuple[float, float]] = field(default_factory=dict)
    shape: tuple[int, int] = (320, 480)
    sensors: dict[str, SimSensor] = field(default_factory=dict)
    """By kind, where it is not the usual one."""
    iso: dict[str, int] = field(default_factory=dict)
    dark_time: float = 1.0
    """Time of the darks over that of their frames, whatever the list says."""
    without: tuple[str, ...] = ()
    """Kinds that were not taken."""
    said: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Keys of session.toml, by table, that are not the truth or are not given by rule."""


class _Rolled(PictureGeometry):
    """A camera turned about its axis, or a sample whose light reaches farther one way."""

    turn: float
    stretch: float

    def homography(self) -> Array:
        turned = np.array(
            [
                [np.cos(self.turn), -np.sin(self.turn), 0.0],
                [np.sin(self.turn), np.cos(self.turn), 0.0],
                [0.0, 0.0, 1.0],
            ]
        )
        x, y = self.centre_px or (0.0, 0.0)
        to_centre = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
        plane = super().homography() @ np.linalg.inv(to_centre) @ turned @ to_centre
        return np.asarray(np.diag([1 / self.stretch, 1.0, 1.0]) @ plane)


def currents(bench: SabotagedBench) -> tuple[dict[str, Array], tuple[float, ...]]:
    """Mean photo-current of each pixel [e⁻/s] by kind, and the tile's radiance factors."""
    scene = BenchScene(published_sample(bench.material), white_tile(), view_angle_deg=bench.view_angle_deg)
    height, width = bench.shape
    out = {}
    for kind, subject in (("sample", scene.sample), ("reference", scene.tile)):
        centre = bench.centre_px.get(kind, ((width - 1) / 2 + 0.3, (height - 1) / 2 - 0.2))
        planes = {
            channel: power * _spot_picture(bench, kind, light, centre)
            for (channel, light), power in zip(scene.light(subject).items(), scene.channel_power, strict=True)
        }
        out[kind] = mosaic(_sensor(bench, kind), planes)
    e_per_s = _PEAK * SimSensor().full_well_e / (max(current.max() for current in out.values()) * EXPOSURES_S[0])
    return {kind: bench.brightness * e_per_s * current for kind, current in out.items()}, scene.radiance_factors(
        scene.tile
    )


def _spot_picture(bench: SabotagedBench, kind: str, light: Any, centre: tuple[float, float]) -> Array:
    """The picture of a beam that may be wider along the view, seen by a camera that may be out of focus."""
    spread = bench.spot_mm / 2 * np.sqrt(max(bench.spot_aspect**2 - 1, 0.0))
    nodes, weights = _SPOT_NODES if spread else (np.zeros(1), np.ones(1))
    along_px = spread * np.cos(np.radians(bench.view_angle_deg)) / bench.mm_per_px
    total = np.zeros(bench.shape)
    for node, weight in zip(nodes, weights / np.sum(weights), strict=True):
        x, y = centre
        moved = (x, y + node * along_px) if bench.view_axis == "y" else (x + node * along_px, y)
        view = _Rolled(bench.shape, bench.mm_per_px, bench.view_angle_deg, bench.view_axis, moved, bench.spot_mm)
        object.__setattr__(view, "turn", np.radians(bench.roll_deg))
        object.__setattr__(view, "stretch", 1 + (bench.fibre if kind == "sample" else 0.0))
        total += weight * picture(light, view)
    blur = bench.blur_px.get(kind, 0.0)
    return np.asarray(cv2.GaussianBlur(total, (0, 0), blur)) if blur else total


def _sensor(bench: SabotagedBench, kind: str) -> SimSensor:
    height, width = bench.shape
    return replace(bench.sensors.get(kind, SimSensor()), height_px=height, width_px=width)


def write_session(path: Path, bench: SabotagedBench, seed: int = 0) -> None:
    """A session folder of this bench."""
    rng = np.random.default_rng(seed)
    light, reflectance = currents(bench)
    (path / "frames").mkdir(parents=True)
    frames = []
    kinds: tuple[FrameKind, ...] = ("sample", "reference", "sample_dark", "reference_dark")
    for kind in kinds:
        subject, _, dark = kind.partition("_")
        sensor = _sensor(bench, subject)
        for number, label_s in enumerate(EXPOSURES_S if kind not in bench.without else ()):
            current = 0.0 if dark else light[subject]
            if kind == "sample" and number > len(EXPOSURES_S) // 2:
                current = np.roll(current, round(bench.shift_px), axis=1)
            seconds = label_s * (bench.dark_time if dark else 1.0)
            frame = expose(sensor, current, seconds, rng)
            file = f"frames/{kind}_{number}.dng"
            (path / file).write_bytes(dng_bytes(frame, sensor, seconds, bench.iso.get(subject, 100)))
            frames.append(Frame(file, kind, label_s))
    write_frames(path, frames)
    (path / "session.toml").write_text(toml_of(bench, reflectance), encoding="utf-8")


def toml_of(bench: SabotagedBench, reflectance: Sequence[float]) -> str:
    """session.toml of this bench."""
    geometry = {"mm_per_px": bench.mm_per_px, "view_angle_deg": bench.view_angle_deg, "view_axis": bench.view_axis}
    eta = next(iter(published_sample(bench.material).media.values())).eta
    tables: dict[str, dict[str, Any]] = {
        "material": {"name": bench.material, "eta": eta, "g": 0.0},
        "camera": {},
        "geometry": geometry,
        "beam": {"kind": "white"},
        "reference": {"name": "Spectralon", "reflectance": list(reflectance), "coplanar": True},
    }
    for name, keys in bench.said.items():
        tables[name] |= keys
    return "format = 1\n" + "".join(f"[{name}]\n{toml_table(table)}" for name, table in tables.items())


class Sabotage(NamedTuple):
    """A session with one fault."""

    bench: SabotagedBench
    causes: tuple[str, ...]
    """Flags that name it."""


def _said(**geometry: Any) -> dict[str, dict[str, Any]]:
    return {"geometry": geometry}


def _tile(factor: float, bench: SabotagedBench) -> SabotagedBench:
    scene = BenchScene(published_sample(bench.material), white_tile())
    return replace(
        bench, said={"reference": {"reflectance": [factor * each for each in scene.radiance_factors(scene.tile)]}}
    )


MARBLE = SabotagedBench()
SKIN = SabotagedBench("Skin1", 0.06, spot_mm=0.2)
SABOTAGES: dict[str, Sabotage] = {
    "axis": Sabotage(replace(MARBLE, said=_said(view_axis="x")), ()),
    "axis, skin": Sabotage(replace(SKIN, said=_said(view_axis="x")), ()),
    "axis the other way": Sabotage(replace(MARBLE, view_axis="x", said=_said(view_axis="y")), ()),
    **{
        f"angle {off:+d}{name}": Sabotage(
            replace(bench, said=_said(view_angle_deg=45.0 + off)), ("view_angle_off", "aspect_off")
        )
        for name, bench in (("", MARBLE), (", skin", SKIN))
        for off in (-15, -5, 5, 15)
    },
    "scale +5 %": Sabotage(replace(MARBLE, said=_said(mm_per_px=0.105)), ("scale_sd_assumed",)),
    "scale -5 %": Sabotage(replace(MARBLE, said=_said(mm_per_px=0.095)), ("scale_sd_assumed",)),
    "tile +2 %": Sabotage(_tile(1.02, MARBLE), ("reflectance_sd_assumed",)),
    "tile -2 %": Sabotage(_tile(0.98, MARBLE), ("reflectance_sd_assumed",)),
    "ISO": Sabotage(replace(MARBLE, iso={"reference": 200}), ()),
    "bits": Sabotage(
        replace(MARBLE, sensors={"reference": SimSensor(bits=12, black_dn=128, gain_e_per_dn=16.0)}), ("bits_differ",)
    ),
    "layout": Sabotage(replace(MARBLE, sensors={"reference": SimSensor(layout="BGGR")}), ("layout_differs",)),
    "no darks": Sabotage(replace(MARBLE, without=("sample_dark",)), ()),
    "darks of another exposure": Sabotage(replace(MARBLE, dark_time=0.25), ("dark_differs",)),
    "out of focus": Sabotage(
        replace(MARBLE, blur_px={"sample": 4.0, "reference": 4.0}, said={"beam": {"spot_radius_mm": 0.25}}),
        ("spot_differs",),
    ),
    "saturated spot": Sabotage(replace(MARBLE, brightness=20.0), ("saturated",)),
    "spot at the edge": Sabotage(replace(MARBLE, centre_px={"sample": (1.0, 160.0)}), ()),
    "moved": Sabotage(replace(MARBLE, shift_px=2.0), ("moved",)),
}


class Caught(NamedTuple):
    """What became of a session."""

    name: str
    caught: bool
    how: str


def judge(name: str, folder: Path, *, holds_truth: Callable[[Path, SabotagedBench], bool] | None = None) -> Caught:
    """Make, measure and judge one session; without `holds_truth` only refusals and flags count."""
    bench, causes = SABOTAGES[name]
    write_session(folder, bench)
    try:
        curve = measure_session(read_session(folder)).slice
    except InputError as error:
        return Caught(name, True, f"refused: {str(error).replace(str(folder), '…')}")
    assert curve is not None
    named = [flag for flag in curve.flags if flag in causes]
    held = holds_truth is not None and holds_truth(folder, bench)
    if named:
        return Caught(name, True, f"flagged: {' '.join(named)}{'; its intervals hold the truth' if held else ''}")
    return Caught(name, held, "its intervals hold the truth" if held else f"missed: flags {' '.join(curve.flags)}")


def truth_is_held(folder: Path, bench: SabotagedBench) -> bool:
    """Whether every interval of the fit that has one holds what the bench was given."""
    (fit,) = fit_slices([read_slice(folder / "measured/slice.csv")], FitOptions())
    media = published_sample(bench.material).media
    return all(
        channel.status == "unidentifiable"
        or (
            channel.sigma_a_interval95_per_mm[0] <= media[name].sigma_a <= channel.sigma_a_interval95_per_mm[1]
            and channel.sigma_sp_interval95_per_mm[0] <= media[name].sigma_sp <= channel.sigma_sp_interval95_per_mm[1]
        )
        for name, channel in fit.items()
    )


def main(names: Sequence[str]) -> None:
    """Judge the named sessions, all where none is named, and print a line for each."""
    outcomes = []
    for name in names or SABOTAGES:
        folder = Path(tempfile.mkdtemp(prefix="bssrdf-sabotage-"))
        try:
            outcomes.append(judge(name, folder / "session", holds_truth=truth_is_held))
        finally:
            shutil.rmtree(folder)
        print(f"{name}: {outcomes[-1].how}", flush=True)
    print(f"{sum(each.caught for each in outcomes)} of {len(outcomes)} caught")


if __name__ == "__main__":
    main(sys.argv[1:])
