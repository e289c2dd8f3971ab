"""A whole session of the simulated bench, written without the drivers: frames, frames.csv, session.toml, truth."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import UsageError
from bssrdf.rig.sim.light import RadialLight, Sample, radial_light
from bssrdf.rig.sim.picture import View, picture
from bssrdf.rig.sim.raw_files import dng_bytes, write_tiff
from bssrdf.rig.sim.sensor import Sensor, expose, mosaic
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.records import Beam, Camera, Frame, FrameKind, Geometry, Material, Reference, Session
from bssrdf.session.session_toml import write_session

BRACKET_S = (0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.128, 0.25, 0.5, 1.0, 2.0, 4.0)

FileFormat = Literal["tiff", "dng"]
Array = NDArray[np.float64]

_PEAK = 0.6
"""Share of the full well that the brightest pixel fills in the shortest exposure."""


@dataclass(frozen=True)
class Bench:
    """The simulated bench: camera, view and the colour of its light."""

    sensor: Sensor = field(default_factory=Sensor)
    mm_per_px: float = 0.1
    view_angle_deg: float = 45.0
    spot_radius_mm: float = 0.2
    channel_power: tuple[float, float, float] = (0.7, 1.0, 0.6)
    """Signal of each channel for the same radiance factor, relative to green."""
    glare: float = 0.0

    @property
    def view(self) -> View:
        return View(self.sensor.shape, self.mm_per_px, self.view_angle_deg, spot_radius_mm=self.spot_radius_mm)


def light_of(sample: Sample, bench: Bench, photons: int, seed: int) -> dict[str, RadialLight]:
    """The light of each channel of a sample under the camera's angle."""
    return {
        channel: radial_light(medium, bench.view_angle_deg, photons=photons, seed=seed)
        for channel, medium in sample.media.items()
    }


def unit_current(light: dict[str, RadialLight], bench: Bench) -> Array:
    """Photo-current of each pixel on the mosaic, over that of a green πL/Φ of 1/mm²."""
    planes = {
        channel: power * picture(curve, bench.view, bench.glare)
        for (channel, curve), power in zip(light.items(), bench.channel_power, strict=True)
    }
    return mosaic(bench.sensor, planes)


def write_simulated_session(
    session: Path,
    truth: Path,
    sample: Sample,
    tile: Sample,
    *,
    bench: Bench,
    file_format: FileFormat = "tiff",
    photons: int = 200_000,
    seed: int = 1,
) -> None:
    """Write the session folder `session`, and what it was made from to the file `truth`, outside of it.

    Every kind of frame is taken at each of `BRACKET_S`. The reflectance of the reference is the tile's own radiance
    factor at the camera's angle, as simulated.
    """
    if session.resolve() in truth.resolve().parents:
        raise UsageError(f"{truth}: the truth must lie outside of the session; choose another file")
    lights = {
        "sample": light_of(sample, bench, photons, seed),
        "reference": light_of(tile, bench, photons, seed + 1000),
    }
    currents = {part: unit_current(light, bench) for part, light in lights.items()}
    e_per_s = _PEAK * bench.sensor.full_well_e / (max(c.max() for c in currents.values()) * BRACKET_S[0])

    (session / "frames").mkdir(parents=True)
    frames: list[Frame] = []
    kind: FrameKind
    light_e_per_s: Array | float
    for kind, light_e_per_s in (
        ("sample", e_per_s * currents["sample"]),
        ("sample_dark", 0.0),
        ("reference", e_per_s * currents["reference"]),
        ("reference_dark", 0.0),
    ):
        frames += _take(session, kind, light_e_per_s, bench.sensor, file_format, seed)
    write_frames(session, frames)

    radiance_factor = {channel: light.total for channel, light in lights["reference"].items()}
    write_session(session, _session(session, sample, tile, radiance_factor, bench, file_format))
    truth.parent.mkdir(parents=True, exist_ok=True)
    truth.write_text(json.dumps(_truth(sample, tile, lights, bench, photons, seed), indent=1) + "\n")


def _take(
    session: Path, kind: FrameKind, light_e_per_s: Array | float, sensor: Sensor, file_format: FileFormat, seed: int
) -> list[Frame]:
    """One bracket of one kind."""
    frames = []
    for number, exposure_s in enumerate(BRACKET_S):
        rng = np.random.default_rng([seed, number, *kind.encode()])
        dn = expose(sensor, light_e_per_s, exposure_s, rng)
        file = f"frames/{kind}_{number:02d}.{'tif' if file_format == 'tiff' else 'dng'}"
        if file_format == "tiff":
            write_tiff(session / file, dn, exposure_s)
        else:
            (session / file).write_bytes(dng_bytes(dn, sensor, exposure_s))
        frames.append(Frame(file, kind, exposure_s))
    return frames


def _session(
    path: Path,
    sample: Sample,
    tile: Sample,
    radiance_factor: dict[str, float],
    bench: Bench,
    file_format: FileFormat,
) -> Session:
    sensor = bench.sensor
    own = Camera(sensor.layout, sensor.black_dn, sensor.white_dn) if file_format == "tiff" else Camera()
    media = next(iter(sample.media.values()))
    return Session(
        path,
        camera=own,
        material=Material(sample.name, media.eta, media.g),
        geometry=Geometry(bench.mm_per_px, view_angle_deg=bench.view_angle_deg, view_axis="y"),
        beam=Beam("white", spot_radius_mm=bench.spot_radius_mm),
        reference=Reference(tile.name, tuple(radiance_factor.values()), (0.001,) * len(radiance_factor)),
    )


def _truth(
    sample: Sample,
    tile: Sample,
    lights: dict[str, dict[str, RadialLight]],
    bench: Bench,
    photons: int,
    seed: int,
) -> dict[str, object]:
    return {
        "light": "Monte Carlo, absorbing walk",
        "photons": photons,
        "seed": seed,
        "sample": asdict(sample),
        "tile": asdict(tile),
        "radiance_factor": {part: {c: curve.total for c, curve in light.items()} for part, light in lights.items()},
        "bench": asdict(bench),
    }
