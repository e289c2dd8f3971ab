"""Faults of frames on the simulated bench: what a lamp, a camera or a person does to a bracket. DN and electrons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from bssrdf.rig import BenchScene, SimSensor, expose, published_sample, white_tile
from bssrdf.session import write_frames
from bssrdf.session.records import Beam, Camera, Frame, FrameKind, Geometry, Material, Reference, Session

Array = NDArray[np.float64]

EXPOSURES_S = (0.001, 0.004, 0.016, 0.064, 0.25, 1.0, 4.0)
_KINDS: tuple[FrameKind, ...] = ("sample", "reference")
_DARKS: tuple[FrameKind, ...] = ("sample_dark", "reference_dark")
_FLICKER_HZ, _FLICKER = 100.0, 0.1
"""A lamp on the mains, and how far its light swings."""
_K_PER_DOUBLING = 6.0
"""Dark current doubles with about this many kelvin."""


@dataclass(frozen=True)
class Shown:
    """What one frame is taken of and by."""

    kind: str
    number: int
    exposure_s: float
    light: float = 1.0
    """Of the lamp, relative."""
    black_dn: float = 0.0
    """By how much black is raised."""
    dark: float = 1.0
    """Dark current, relative."""


Fault = Callable[[list[Shown], np.random.Generator], list[Shown]]


def good(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    return frames


def lamp(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    """Loses 5 % over the bracket of the sample, of the tile, or of both."""
    kinds = [("sample",), ("reference",), _KINDS][rng.integers(3)]
    last = len(EXPOSURES_S) - 1
    return [replace(f, light=1 - 0.05 * f.number / last) if f.kind in kinds else f for f in frames]


def flicker(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    """Each exposure catches another part of the lamp's period; long ones catch many."""
    swing = [_FLICKER * np.sinc(_FLICKER_HZ * f.exposure_s) * np.cos(rng.uniform(0, 2 * np.pi)) for f in frames]
    return [replace(f, light=1 + each) for f, each in zip(frames, swing, strict=True)]


def black(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    """Black of one kind's frames lies off that of its darks."""
    kind, offset = _KINDS[rng.integers(2)], rng.choice([-1, 1]) * rng.uniform(0.5, 4)
    return [replace(f, black_dn=offset) if f.kind == kind else f for f in frames]


def darks(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    """All darks were taken warmer or colder."""
    kelvin = rng.choice([-1, 1]) * rng.uniform(2, 10)
    return [replace(f, dark=2 ** (kelvin / _K_PER_DOUBLING)) if f.kind.endswith("dark") else f for f in frames]


def stale(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    """One frame is that before it once more."""
    kind, number = _KINDS[rng.integers(2)], int(rng.integers(1, len(EXPOSURES_S)))
    return [
        replace(f, exposure_s=EXPOSURES_S[number - 1]) if (f.kind, f.number) == (kind, number) else f for f in frames
    ]


def exchanged(frames: list[Shown], rng: np.random.Generator) -> list[Shown]:
    """Two labels of one kind."""
    kind, pair = _KINDS[rng.integers(2)], rng.choice(len(EXPOSURES_S), 2, replace=False).tolist()
    swap = {pair[0]: pair[1], pair[1]: pair[0]}
    return [
        replace(f, exposure_s=EXPOSURES_S[swap[f.number]]) if f.kind == kind and f.number in swap else f for f in frames
    ]


FAULTS: dict[str, Fault] = {f.__name__: f for f in (good, lamp, flicker, black, darks, stale, exchanged)}


@dataclass(frozen=True)
class Setup:
    """What is filmed, and how."""

    material: str = "marble"
    view_angle_deg: float = 45.0
    incidence_deg: float = 0.0
    spot_aspect: float = 1.0
    spread_aspect: float = 1.0
    """Of the sample: fibres."""


PLAIN = Setup()


@lru_cache(maxsize=2)
def scene(setup: Setup = PLAIN) -> BenchScene:
    """A small camera of one colour on a published material."""
    sample, tile = (
        replace(each, media={"G": each.media["G"]}) for each in (published_sample(setup.material), white_tile())
    )
    return BenchScene(
        replace(sample, spread_aspect=setup.spread_aspect),
        tile,
        SimSensor(200, 300, "mono"),
        mm_per_px=0.15,
        view_angle_deg=setup.view_angle_deg,
        incidence_deg=setup.incidence_deg,
        spot_aspect=setup.spot_aspect,
        channel_power=(1.0,),  # type: ignore[arg-type]  # one channel
    )


@lru_cache(maxsize=2)
def currents(setup: Setup = PLAIN) -> dict[str, Array]:
    """Mean photo-current [e⁻/s] by what lies under the beam."""
    return scene(setup).photo_currents()


def session_of(path: Path, camera: Camera, setup: Setup = PLAIN) -> Session:
    """The session that the frames in `path` belong to, as a user would describe it."""
    bench = scene(setup)
    return Session(
        path,
        camera,
        Material(setup.material, bench.sample.media["G"].eta, bench.sample.media["G"].g),
        Geometry(bench.mm_per_px, mm_per_px_rel_sd=0.001, view_angle_deg=bench.view_angle_deg, view_angle_sd_deg=0.1),
        Beam(spot_radius_mm=bench.spot_radius_mm, channels=("G",), incidence_deg=bench.incidence_deg),
        Reference("tile", bench.radiance_factors(bench.tile), (1e-6,), coplanar=True),
    )


def write_session(path: Path, fault: Fault, seed: int, setup: Setup = PLAIN, repeats: int = 1) -> Session:
    """Frames of a bracket of sample and tile with their darks, and a fault."""
    rng = np.random.default_rng(seed)
    (path / "frames").mkdir(parents=True)
    listed = []
    for repeat in range(repeats):
        planned = [Shown(kind, n, t) for kind in (*_KINDS, *_DARKS) for n, t in enumerate(EXPOSURES_S)]
        for shown in fault(planned, rng):
            sensor = scene(setup).sensor
            sensor = replace(sensor, dark_e_per_s=sensor.dark_e_per_s * shown.dark)
            light = shown.light * currents(setup).get(shown.kind, np.zeros(sensor.shape))
            raw = _moved(expose(sensor, light, shown.exposure_s, rng), shown.black_dn, sensor, rng)
            file = f"frames/{shown.kind}_{shown.number}_{repeat}.tif"
            tifffile.imwrite(path / file, raw)
            listed.append(Frame(file, shown.kind, EXPOSURES_S[shown.number]))  # type: ignore[arg-type]  # a FrameKind
    write_frames(path, listed)
    return session_of(path, Camera(sensor.layout, float(sensor.black_dn), float(sensor.white_dn)), setup)


def _moved(raw: NDArray[np.uint16], by_dn: float, sensor: SimSensor, rng: np.random.Generator) -> NDArray[np.uint16]:
    """The frame with its black moved, by parts of a DN too."""
    if by_dn == 0:
        return raw
    moved = np.floor(raw + by_dn + rng.random(raw.shape))
    return np.where(raw >= sensor.white_dn, raw, np.clip(moved, 0, sensor.white_dn)).astype(np.uint16)
