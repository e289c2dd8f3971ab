"""A folder of RAW files as a camera leaves it, of marble and a white tile on the simulated bench's light."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bssrdf.rig.sim.media import published_sample, white_tile
from bssrdf.rig.sim.picture import picture
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.scene import BenchScene
from bssrdf.rig.sim.sensor import SimSensor, expose, mosaic

EXPOSURES_S = (1 / 1000, 1 / 250, 1 / 60, 1 / 15, 1 / 4, 1.0, 4.0)


def marble() -> BenchScene:
    """Marble beside Spectralon, in a small frame."""
    return BenchScene(published_sample("marble"), white_tile(), SimSensor(height_px=300, width_px=400))


def film(scene: BenchScene, folder: Path) -> None:
    """A bracket of the marble and of the tile, and darks, with names as a camera gives them."""
    rng = np.random.default_rng(5)
    light = {}
    for name, sample in (("stone", scene.sample), ("tile", scene.tile)):
        powers = zip(scene.light(sample).items(), scene.channel_power, strict=True)
        light[name] = mosaic(
            scene.sensor, {channel: power * picture(seen, scene.view) for (channel, seen), power in powers}
        )
    scale = 0.1 * scene.sensor.full_well_e / (max(plane.max() for plane in light.values()) * EXPOSURES_S[0])
    for name, plane in (*light.items(), ("dark", np.zeros(scene.sensor.shape))):
        (folder / name).mkdir(parents=True)
        for number, exposure_s in enumerate(EXPOSURES_S):
            dn = expose(scene.sensor, scale * plane, exposure_s, rng)
            (folder / name / f"IMG_{number:04}.DNG").write_bytes(dng_bytes(dn, scene.sensor, exposure_s))


def edit(file: Path, scene: BenchScene) -> None:
    text = file.read_text(encoding="utf-8")
    values = {
        "name": ('"unnamed"', '"Marble"'),
        "eta": ("1.3", "1.5"),
        "mm_per_px": ("0.05", str(scene.mm_per_px)),
        "reflectance": ("[0.99, 0.99, 0.99]", str([round(factor, 4) for factor in scene.radiance_factors(scene.tile)])),
    }
    for key, (old, new) in values.items():
        assert f"\n{key} = {old}" in text
        text = text.replace(f"\n{key} = {old}", f"\n{key} = {new}")
    file.write_text(text.replace("\n# g = 0.0", "\ng = 0.0"), encoding="utf-8")
