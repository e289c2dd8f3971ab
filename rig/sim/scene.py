"""The simulated bench as one document: camera, light and samples. Its launcher writes it, the camera reads it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.rig.sim.light import SeenLight, seen_light
from bssrdf.rig.sim.media import SampleMedium, SimSample
from bssrdf.rig.sim.picture import PictureGeometry, picture
from bssrdf.rig.sim.sensor import SimSensor, mosaic

BRACKET_S = (0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.128, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Exposure times that the simulated camera can be set to."""

Array = NDArray[np.float64]

_PEAK = 0.1
"""Share of the full well that the brightest pixel fills in the shortest exposure."""


@dataclass(frozen=True)
class BenchScene:
    """Sample and tile, and how they are lit and seen."""

    sample: SimSample
    tile: SimSample
    sensor: SimSensor = field(default_factory=SimSensor)
    mm_per_px: float = 0.1
    view_angle_deg: float = 45.0
    spot_radius_mm: float = 0.2
    spot_aspect: float = 1.0
    incidence_deg: float = 0.0
    """Of the beam, which runs towards the camera's side."""
    perspective: float = 0.0
    scale_error: float = 0.0
    tile_error: float = 0.0
    """Relative errors of what rig.toml says of scale and tile, within the errors that it states for them."""
    glare: float = 0.0
    channel_power: tuple[float, float, float] = (0.7, 1.0, 0.6)
    """Signal of each channel for the same radiance factor, relative to green."""
    photons: int = 200_000
    """Of a walk, where the light of a medium does not ship with the package."""
    seed: int = 1
    noise: str = "fresh"
    """With "repeatable", the same exposure of the same subject gives the same file again."""

    @property
    def view(self) -> PictureGeometry:
        return PictureGeometry(
            self.sensor.shape,
            self.mm_per_px,
            self.view_angle_deg,
            spot_radius_mm=self.spot_radius_mm,
            spot_aspect=self.spot_aspect / float(np.cos(np.radians(self.incidence_deg))),
            perspective=self.perspective,
        )

    def light(self, sample: SimSample) -> dict[str, SeenLight]:
        """The light of each channel of a sample under the camera's angle."""
        return {
            channel: seen_light(
                medium, self.view_angle_deg, photons=self.photons, seed=self.seed, incidence_deg=self.incidence_deg
            )
            for channel, medium in sample.media.items()
        }

    def photo_currents(self) -> dict[str, Array]:
        """Mean photo-current of each pixel [e⁻/s] on the mosaic, by what lies under the beam."""
        currents = {"sample": self._unit_current(self.sample), "reference": self._unit_current(self.tile)}
        brightest = max(current.max() for current in currents.values())
        e_per_s = _PEAK * self.sensor.full_well_e / (brightest * BRACKET_S[0])
        return {subject: e_per_s * current for subject, current in currents.items()}

    def radiance_factors(self, sample: SimSample) -> tuple[float, ...]:
        """Radiance factor of each channel at the camera's angle."""
        return tuple(curve.total for curve in self.light(sample).values())

    def _unit_current(self, sample: SimSample) -> Array:
        view = replace(self.view, spread_aspect=sample.spread_aspect)
        planes = {
            channel: power * picture(curve, view, self.glare)
            for (channel, curve), power in zip(self.light(sample).items(), self.channel_power, strict=True)
        }
        return mosaic(self.sensor, planes)


def write_scene(path: Path, scene: BenchScene) -> None:
    """Write the document; it is the ground truth, so it lies outside of every session."""
    document = asdict(scene)
    document["light"] = "Monte Carlo, absorption in the walk"
    document["radiance_factor"] = {sample.name: scene.radiance_factors(sample) for sample in (scene.sample, scene.tile)}
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def read_scene(path: Path) -> BenchScene:
    """The scene of a document."""
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    del document["light"], document["radiance_factor"]
    sample, tile = (_sample(document.pop(part)) for part in ("sample", "tile"))
    sensor = SimSensor(**document.pop("sensor"))
    document["channel_power"] = tuple(document["channel_power"])
    return BenchScene(sample, tile, sensor, **document)


def _sample(document: dict[str, Any]) -> SimSample:
    media = {channel: SampleMedium(**medium) for channel, medium in document["media"].items()}
    return SimSample(document["name"], media, document["spread_aspect"])
