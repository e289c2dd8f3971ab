"""The builders that tests share: of slices from light, and of sessions from pictures. Lengths in mm."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from bssrdf.rig.sim.light import seen_light
from bssrdf.rig.sim.media import SampleMedium
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.records import ChannelSlice, Frame, FrameKind, Session, Slice
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import ForwardModel

Floats = NDArray[np.float64]

FIXTURES = Path(__file__).parent / "fixtures"
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real and independent data beside the checkout, which a public clone lacks."""
OF_TWO_CODES = [f"{code}/{name}" for code in ("walk", "mcml") for name in ("marbleG_g0", "skin1G_g0.8", "ketchupR_g0")]
"""Curves that share no line with the package: those of `literal_walk`, and the same media by MCML where it is."""

KINDS: tuple[FrameKind, ...] = ("sample", "sample_dark", "reference", "reference_dark")


@dataclass(frozen=True)
class Curve:
    """Means of R_d [1/mm²] over rings, with standard errors, and R; per entering flux."""

    sigma_a: float
    sigma_sp: float
    eta: float
    g: float
    r_lo: Floats
    r_hi: Floats
    rd: Floats
    se: Floats
    total_r: float


def curve_file(name: str) -> Path:
    """One of OF_TWO_CODES; the test is skipped where the file is absent."""
    code, medium = name.split("/")
    path = (FIXTURES if code == "walk" else SHARED / "mc") / f"{medium}.csv"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    return path


def real_data(name: str) -> Path:
    """A folder of SHARED; the test is skipped where it is absent."""
    if not (SHARED / name).is_dir():
        pytest.skip(f"{SHARED / name} is not here")
    return SHARED / name


def curve(name: str) -> Curve:
    path = curve_file(name)
    text = path.read_text(encoding="utf-8")
    sigma_sp, sigma_a, eta, g, total_r = (
        float(text.split(f"{key}=")[1].split()[0].removesuffix("/mm"))
        for key in ("sigma_s_prime", "sigma_a", " eta", " g", "total_R_entering")
    )
    return Curve(sigma_a, sigma_sp, eta, g, *np.loadtxt(path, delimiter=",", skiprows=5).T, total_r)


def curve_slice(of: Curve, *, least_sd: float = 0.005, **keys: Any) -> Slice:
    """A slice of the curve, each ring known to its own error and `least_sd`; `keys` as in `slice_of`."""
    sd = np.hypot(of.se / of.rd, least_sd)
    seen = of.rd > 0
    lo, hi, rd, sd = (each[seen] for each in (of.r_lo, of.r_hi, of.rd, sd))
    medium = {"eta": of.eta, "g": of.g, "total_r": of.total_r, "total_sd": 0.001}
    return slice_of((lo + hi) / 2, rd, edges=(lo, hi), sd=sd, **{**medium, **keys})


def seen_slice(sigma_a: float, sigma_sp: float, **keys: Any) -> Slice:
    """The bench's light of a medium of η 1.3 as a camera at 45° sees it across the view."""
    light = seen_light(SampleMedium(sigma_a, sigma_sp, 1.3), 45.0, photons=1, seed=1)
    assert light.harmonics is not None
    edges, across = light.r_edges_mm, 1 + np.cos(np.arange(1, 13) * np.pi / 2) @ light.harmonics
    used = (edges[:-1] * (sigma_a + sigma_sp) > 0.7) & (light.beyond[1:] > 1e-4 * light.total)
    lo, hi = edges[:-1][used], edges[1:][used]
    rd = (-np.diff(light.beyond) * across)[used] / (np.pi * (hi**2 - lo**2))
    keys = {"flux": "incident", "exit": "fresnel", "g": 0.0, **keys}
    return slice_of((lo + hi) / 2, rd, edges=(lo, hi), total_r=light.total, **keys)


def changed(
    piece: Slice,
    *,
    r: float = 1.0,
    rd: Floats | float = 1.0,
    sd: Floats | float | None = None,
    total_r: float = 1.0,
    **keys: Any,
) -> Slice:
    """The slice with radii, values, errors and R multiplied, errors with their values where nothing is said of them."""
    part = piece.channels["G"]
    edges = {key: None if (at := getattr(part, key)) is None else at * r for key in ("r_mm", "r_lo_mm", "r_hi_mm")}
    sds = part.sd_per_mm2 * (rd if sd is None else sd)
    channel = replace(part, **edges, rd_per_mm2=part.rd_per_mm2 * rd, sd_per_mm2=sds)
    totals = {name: value * total_r for name, value in piece.total_r.items()}
    return replace(piece, **{"channels": {"G": channel}, "total_r": totals, **keys})


def with_rd(piece: Slice, rd: Floats) -> Slice:
    """The slice with other values and the same errors."""
    return replace(piece, channels={"G": replace(piece.channels["G"], rd_per_mm2=rd)})


def slice_of(
    r_mm: Floats,
    rd: Floats,
    *,
    edges: tuple[Floats, Floats] | None = None,
    noise: float = 0.0,
    sd: float | Floats = 0.01,
    total_r: float | None = None,
    total_noise: float = 0.0,
    total_sd: float = 0.002,
    seed: int = 0,
    **keys: Any,
) -> Slice:
    """A slice of one channel, G, of light R_d [1/mm²] and R.

    `noise` is drawn and `sd` is stated, both relative; so are those of R. `keys` are those of a Slice, by default per
    entering flux over the hemisphere.
    """
    rng = np.random.default_rng(seed)
    values = rd * (1 + noise * rng.standard_normal(rd.size))
    known = {} if total_r is None else {"G": total_r * (1 + total_noise * rng.standard_normal())}
    sds = {"G": total_sd * total_r} if total_r is not None and total_sd else {}
    channel = ChannelSlice(r_mm, values, sd * np.abs(rd), *(edges or ()))
    given = {"eta": 1.3, "flux": "entering", "exit": "hemisphere", "total_r": known, "total_r_sd": sds, **keys}
    return Slice({"G": channel}, **given)


def model_slice(
    model: ForwardModel, sigma_a: float, sigma_sp: float, r_mfp: Floats, *, factor: float = 1.0, **keys: Any
) -> Slice:
    """The light of a model at radii in mean free paths, curve and R times `factor`; `keys` as in `slice_of`."""
    r_mm = r_mfp / (sigma_a + sigma_sp)
    rd, total_r = model_light(model, sigma_a, sigma_sp, r_mm)
    return slice_of(r_mm, factor * rd, total_r=factor * total_r, **{"eta": float(model.eta), **keys})


def model_light(model: ForwardModel, sigma_a: float, sigma_sp: float, r_mm: Floats) -> tuple[Floats, float]:
    """R_d [1/mm²] and R of a medium, in double precision."""
    with jax.enable_x64(True):
        medium = Medium(sigma_a, sigma_sp, float(model.eta))
        return np.asarray(model.rd(medium, r_mm)), float(model.total(medium))


def film(
    session: Session,
    light: Callable[[FrameKind, int, int], Floats],
    exposures_s: Sequence[float],
    rng: np.random.Generator,
    *,
    gain_e_per_dn: float = 1.0,
    read_noise_e: float = 3.0,
    dark_e_per_s: float = 2.0,
    true_s: Sequence[float] | None = None,
    repeats: int = 1,
) -> Session:
    """Write frames and frames.csv of a session: brackets of sample and reference, each with its darks.

    `light` [e/s] is that of a kind, the number of its exposure and of its repeat. Exposures last `true_s`, where that
    is not what their labels say. What a frame holds is Poisson's, with read noise, rounded and cut off at white.
    """
    black, white = session.camera.black or 0.0, session.camera.white or 65535
    (session.path / "frames").mkdir(parents=True)
    frames = []
    for kind, number, repeat in itertools.product(KINDS, range(len(exposures_s)), range(repeats)):
        mean = (light(kind, number, repeat) + dark_e_per_s) * (true_s or exposures_s)[number]
        electrons = rng.poisson(mean) + rng.normal(0, read_noise_e, mean.shape)
        dn = np.clip(np.rint(electrons / gain_e_per_dn) + black, 0, white).astype(np.uint16)
        file = f"frames/{kind}_{number}{f'_{repeat}' if repeats > 1 else ''}.tif"
        tifffile.imwrite(session.path / file, dn)
        frames.append(Frame(file, kind, exposures_s[number]))
    write_frames(session.path, frames)
    return session


def of_kinds(pictures: Mapping[str, Floats], e_per_s: float) -> Callable[[FrameKind, int, int], Floats]:
    """Light for `film` that is the same in every frame of a kind, and none in darks."""
    nothing = np.zeros_like(next(iter(pictures.values())))
    return lambda kind, number, repeat: e_per_s * pictures.get(kind, nothing)


BENT_MS = (25, 50, 100, 250, 500, 2000, 3916)


def bent_bracket(folder: Path, wavelength_nm: int, *, bend: float = 0.04, down: bool = True) -> None:
    """A bracket of a camera like the Flea3 of SHARED, with two darks each: 8 bits, rounded `down` or to the next, cut
    off at black, a response that bends by `bend` over the range. Light falls over two decades from left to right."""
    rng = np.random.default_rng(wavelength_nm)
    shape, gain, span = (172, 204), 25.0, 255.0
    y, x = np.mgrid[: shape[0], : shape[1]]
    e_per_s = 0.8 * span * gain / 0.025 * 10 ** (-2.2 * x / shape[1]) * (1 + 0.1 * np.sin(y / 7))
    for name, light in (("frames", e_per_s), ("darks", 0 * e_per_s)):
        (folder / name).mkdir(exist_ok=True, parents=True)
        for ms in BENT_MS:
            for repeat in range(1 if name == "frames" else 2):
                electrons = rng.poisson(light * ms / 1000) + rng.normal(0, 10, shape)
                straight = electrons / gain
                shown = straight.copy()
                for _ in range(20):
                    shown = straight / (1 + bend / span * (shown - span / 2))
                dn = np.clip(np.floor(shown) if down else np.rint(shown), 0, 255).astype(np.uint8)
                kind = f"{wavelength_nm}nm" if name == "frames" else f"dark{repeat}"
                tifffile.imwrite(folder / name / f"d1_{kind}_{ms}ms_0.tif", dn)
