"""Film the tutorial's session on the simulated bench: `python docs/tutorial_session.py`.

Marble beside a tile, 16 frames of 14 bits as deflated TIFF. The scale and the tile's reflectance are off by errors
drawn from those that session.toml states, as on a bench.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from bssrdf.rig import SCALE_REL_SD, TILE_SD, BenchScene, SimSensor, expose, published_sample, white_tile

SESSION = Path(__file__).parent / "tutorial" / "marble"
BRACKET_S = (0.001, 0.008, 0.064, 0.5, 4.0)
SEED = 1
SENSOR = SimSensor(height_px=260, width_px=400, seed=SEED)
SESSION_TOML = """\
# What was measured, and with what. `bssrdf init` writes a file like this, with every key that there is.
[material]
name = "Marble"
eta = 1.5                     # index of refraction
g = 0.0                       # mean cosine of scattering: not known, and hardly felt by a material as white as this

[camera]
white = {white}                 # where the camera clips; of RAW files the file says it

[geometry]
mm_per_px = {mm_per_px:.5f}           # from a ruler in the sample's plane
mm_per_px_rel_sd = {scale_sd}
view_angle_deg = 45.0         # camera against the surface normal
view_angle_sd_deg = 0.2
view_axis = "y"               # the image axis that the view foreshortens

[beam]
kind = "white"
spot_radius_mm = {spot_radius_mm}         # to 1/e²

[reference]
name = "Spectralon"
reflectance = {reflectance}   # radiance factor at 45°, by channel
reflectance_sd = {reflectance_sd}
coplanar = true               # the tile lay where the sample lies
"""


def main(session: Path) -> None:
    draw = np.random.default_rng(SEED)
    scene = BenchScene(
        published_sample("Marble"),
        white_tile(),
        SENSOR,
        mm_per_px=0.1,
        spot_radius_mm=0.3,
        scale_error=SCALE_REL_SD * draw.normal(),
        tile_error=TILE_SD * draw.normal(),
    )
    (session / "frames").mkdir(parents=True, exist_ok=True)
    lines = ["file,kind,exposure_s,sha256"]
    for name, kind, exposure_s, dn in film(scene, draw):
        file = session / "frames" / name
        write_tiff(file, dn, exposure_s)
        lines.append(f"frames/{name},{kind},{exposure_s:g},{sha256(file.read_bytes()).hexdigest()}")
    (session / "frames.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    (session / "session.toml").write_text(session_toml(scene), encoding="utf-8")


def film(scene: BenchScene, draw: np.random.Generator) -> Iterator[tuple[str, str, float, NDArray[np.uint16]]]:
    """Name, kind, exposure [s] and numbers of every frame: both brackets, and darks that serve both."""
    currents = {**scene.photo_currents(), "dark": np.zeros(scene.sensor.shape)}
    for kind, current in currents.items():
        for exposure_s in BRACKET_S:
            yield f"{kind}_{1000 * exposure_s:g}ms.tif", kind, exposure_s, expose(SENSOR, current, exposure_s, draw)


def write_tiff(file: Path, dn: NDArray[np.uint16], exposure_s: float) -> None:
    """The mosaic with its colour filters and exposure as tags, deflated."""
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes("RGB".index(channel) for channel in SENSOR.layout), True),  # CFAPattern
        (33434, "2I", 1, (round(1000 * exposure_s), 1000), True),  # ExposureTime
    ]
    tifffile.imwrite(
        file, dn, photometric=32803, compression="zlib", compressionargs={"level": 9}, extratags=tags, metadata=None
    )


def session_toml(scene: BenchScene) -> str:
    reflectance = [factor * (1 + scene.tile_error) for factor in scene.radiance_factors(scene.tile)]
    return SESSION_TOML.format(
        mm_per_px=scene.mm_per_px * (1 + scene.scale_error),
        white=SENSOR.white_dn,
        scale_sd=SCALE_REL_SD,
        spot_radius_mm=scene.spot_radius_mm,
        reflectance=[round(factor, 4) for factor in reflectance],
        reflectance_sd=[round(TILE_SD * factor, 4) for factor in reflectance],
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else SESSION)
