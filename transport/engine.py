"""Monte Carlo transport of light in a homogeneous medium with a flat surface, absorption in the walk.

Lengths in mm, coefficients in 1/mm. Values are per unit flux that entered the medium. Nothing here is shared with the
tables but the elementary steps of a photon (`photon`), so one tests the other.
"""

from __future__ import annotations

import functools
import math
import threading
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bssrdf.errors import InputError
from bssrdf.transport.discrete_ordinates import decay_constant
from bssrdf.transport.exit_radiance import MAX_ANGLE_DEG, N_MU, angle_weights
from bssrdf.transport.parallel import Progress, run_all
from bssrdf.transport.photon import CACHE_LINES, stream_states
from bssrdf.transport.slab import MILNE
from bssrdf.transport.walk import Vessel, walk

Floats = NDArray[np.float64]

MIN_BATCHES = 20
CHUNK = 500
"""Photons between two looks at the stop flag."""


@dataclass(frozen=True)
class MonteCarloMedium:
    """A half space under a smooth surface, a slab if `thickness_mm` is given, a round dish if `width_mm` is."""

    sigma_a: float
    sigma_s: float
    """Scattering coefficient [1/mm], not reduced."""
    g: float = 0.0
    """Mean cosine of the Henyey–Greenstein phase function."""
    eta: float = 1.0
    thickness_mm: float | None = None
    backing: Literal["black", "matched", "air"] | float = "black"
    """Under a slab: black takes in all light that arrives, matched lets it pass on for good (and counts it), air is a
    smooth surface (what passes it counts too), a number the share of light that comes back diffusely."""
    width_mm: float | None = None
    """Inner diameter of a round dish about the beam."""
    wall: Literal["black", "air"] = "black"

    def __post_init__(self) -> None:
        _require(0 <= self.sigma_a < math.inf, "sigma_a", self.sigma_a, "give a finite value of at least 0 [1/mm]")
        _require(0 < self.sigma_s < math.inf, "sigma_s", self.sigma_s, "give a finite value above 0 [1/mm]")
        _require(-1 < self.g < 1, "g", self.g, "give a value between -1 and 1, both excluded")
        _require(1 <= self.eta < 10, "eta", self.eta, "give an index of at least 1 (inside over outside)")
        if self.thickness_mm is not None:
            _require(0 < self.thickness_mm < math.inf, "thickness_mm", self.thickness_mm, "give a value above 0")
        diffuse = isinstance(self.backing, int | float) and 0 <= self.backing < 1
        _require(
            diffuse or self.backing in ("black", "matched", "air"),
            "backing",
            self.backing,
            'give "black", "matched", "air", or a diffuse reflectance from 0 to below 1',
        )
        if self.width_mm is not None:
            _require(0 < self.width_mm < math.inf, "width_mm", self.width_mm, "give a value above 0")
        _require(self.wall in ("black", "air"), "wall", self.wall, 'give "black" or "air"')

    @classmethod
    def reduced(
        cls, sigma_a: float, sigma_sp: float, g: float = 0.0, eta: float = 1.0, thickness_mm: float | None = None
    ) -> MonteCarloMedium:
        """The medium of reduced scattering coefficient `sigma_sp` = σs(1 − g)."""
        _require(-1 < g < 1, "g", g, "give a value between -1 and 1, both excluded")
        return cls(sigma_a, sigma_sp / (1 - g), g, eta, thickness_mm)

    @property
    def sigma_t(self) -> float:
        """Extinction coefficient σt."""
        return self.sigma_a + self.sigma_s

    def decay_constant(self, r_max_mm: float) -> float:
        """How fast light falls up to a radius [1/mm]: of a slab, where it is far, to the 10 % that splitting needs."""
        bulk = decay_constant(self.sigma_s / self.sigma_t, self.g) * self.sigma_t
        if self.thickness_mm is None or r_max_mm < 3 * self.thickness_mm:
            return bulk
        rho = self.backing if isinstance(self.backing, int | float) else 0.0
        mfp = 1 / (self.sigma_a + self.sigma_s * (1 - self.g))
        half_waves = (1 + (1 - rho) / (1 + rho)) / 2  # a quarter of a wave fits a slab on white
        return math.hypot(bulk, math.pi * half_waves / (self.thickness_mm + 2 * MILNE * mfp))

    @property
    def vessel(self) -> Vessel:
        """What holds it, in mean free paths 1/σt."""
        named: dict[object, float] = {"black": 0.0, "matched": 0.0, "air": -1.0}
        back = named[self.backing] if isinstance(self.backing, str) else self.backing
        return Vessel(
            math.inf if self.thickness_mm is None else self.thickness_mm * self.sigma_t,
            float(back),
            math.inf if self.width_mm is None else self.width_mm / 2 * self.sigma_t,
            self.wall == "black",
        )


@dataclass(frozen=True)
class IncidentBeam:
    """A beam centred on r = 0; the default is a pencil at normal incidence."""

    radius_mm: float = 0.0
    """1/e² radius of the irradiance across the beam; 0 is a pencil."""
    incidence_deg: float = 0.0
    """Angle to the surface normal, outside."""

    def __post_init__(self) -> None:
        _require(0 <= self.radius_mm < math.inf, "radius_mm", self.radius_mm, "give a finite value of at least 0")
        _require(0 <= self.incidence_deg < 90, "incidence_deg", self.incidence_deg, "give an angle from 0 to below 90")


@dataclass(frozen=True)
class Tally:
    """What left the medium, by batch; values and standard errors come from the batches' mean and spread."""

    medium: MonteCarloMedium
    beam: IncidentBeam
    r_edges_mm: Floats
    """(n_r + 1,), from 0; all light beyond the last edge is one more bin, in totals only."""
    scores: Floats
    """(batches, 2 sides, 3 orders of scattering 0, 1, ≥ 2, n_r + 1, N_MU): flux per entered photon."""
    paths_mm: Floats
    """(batches, 2 sides, n_r + 1): flux × path length."""
    n_photons: int
    steps: int
    lost: float
    """Share of light given up after a million scatterings: > 0 only near σa = 0 in a half space."""
    interrupted: bool
    """Stopped by Ctrl-C: the batches finished until then are here."""

    @property
    def area_mm2(self) -> Floats:
        """Area of each annulus, (n_r,)."""
        return math.pi * np.diff(self.r_edges_mm**2)

    def rd(self, order: Literal["all", "first", "multiple"] = "all") -> tuple[Floats, Floats]:
        """R_d [1/mm²] averaged over each annulus, and its standard error; of one order of scattering or of all."""
        orders = {"all": slice(None), "first": slice(1, 2), "multiple": slice(2, None)}[order]
        return _mean_se(self.scores[:, 0, orders, :-1].sum((1, 3)) / self.area_mm2)

    def total_r(self, order: Literal["all", "first", "multiple"] = "all") -> tuple[float, float]:
        """Total diffuse reflectance and its standard error."""
        orders = {"all": slice(None), "first": slice(1, 2), "multiple": slice(2, None)}[order]
        value, error = _mean_se(self.scores[:, 0, orders].sum((1, 2, 3)))
        return float(value), float(error)

    def total_t(self) -> tuple[float, float]:
        """Share of the light that passes a slab into what is under it, the unscattered included, and its error."""
        if self.medium.backing not in ("matched", "air"):
            return 0.0, 0.0
        value, error = _mean_se(self.scores[:, 1].sum((1, 2, 3)))
        return float(value), float(error)

    def mean_path_mm(self) -> Floats:
        """Mean path length of the light that leaves from each annulus, (n_r,); NaN where none did."""
        flux = self.scores[:, 0, :, :-1].sum((0, 1, 3))
        return np.divide(self.paths_mm[:, 0, :-1].sum(0), flux, out=np.full_like(flux, np.nan), where=flux > 0)

    def radiance(self, angle_deg: float) -> tuple[Floats, Floats]:
        """π L [1/mm²] per entered flux at a camera `angle_deg` off the normal, by annulus, with standard errors."""
        weights = self._angle_weights(angle_deg)
        return _mean_se(self.scores[:, 0, :, :-1].sum(1) @ weights / self.area_mm2)

    def total_radiance(self, angle_deg: float) -> tuple[float, float]:
        """π L at `angle_deg` integrated over the surface: the total reflectance that a camera there sees."""
        value, error = _mean_se(self.scores[:, 0].sum((1, 2)) @ self._angle_weights(angle_deg))
        return float(value), float(error)

    def _angle_weights(self, angle_deg: float) -> Floats:
        _require(0 <= angle_deg <= MAX_ANGLE_DEG, "angle", angle_deg, f"give 0 to {MAX_ANGLE_DEG:g} degrees")
        return angle_weights(self.medium.eta, math.cos(math.radians(angle_deg)))


def simulate(
    medium: MonteCarloMedium,
    beam: IncidentBeam | None = None,
    *,
    r_edges_mm: ArrayLike,
    n_photons: int,
    seed: int,
    n_batches: int = 32,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> Tally:
    """Follow `n_photons`, rounded up to whole batches, each batch with its own random stream.

    The result is the same for a seed on any number of threads. Ctrl-C returns what is finished, if that is at least
    two batches. Raises InputError for radii that do not ascend from 0.
    """
    beam = beam or IncidentBeam()
    edges = _edges(r_edges_mm)
    _require(n_batches >= MIN_BATCHES, "n_batches", n_batches, f"give at least {MIN_BATCHES}")
    _require(n_photons > 0, "n_photons", n_photons, "give at least 1")
    per_batch = -(-n_photons // n_batches)
    stop = threading.Event()
    batches = [
        functools.partial(_batch, medium, beam, edges, per_batch, state, stop)
        for state in stream_states(seed, n_batches)
    ]
    done, interrupted = run_all(batches, stop, n_threads, progress)
    return Tally(
        medium,
        beam,
        edges,
        scores=np.stack([scores for scores, _, _ in done]) / per_batch,
        paths_mm=np.stack([paths for _, paths, _ in done]) / per_batch,
        n_photons=per_batch * len(done),
        steps=sum(int(counts[0]) for _, _, counts in done),
        lost=sum(counts[2] for _, _, counts in done) / (per_batch * len(done)),
        interrupted=interrupted,
    )


def _batch(
    medium: MonteCarloMedium,
    beam: IncidentBeam,
    edges_mm: Floats,
    n_photons: int,
    state: NDArray[np.uint64],
    stop: threading.Event,
) -> tuple[Floats, Floats, Floats] | None:
    """Scores, paths [mm] and counts of one stream; None if stopped before its end."""
    sigma_t = medium.sigma_t
    scores = np.zeros((2, 3, edges_mm.size, N_MU))
    paths = np.zeros((2, edges_mm.size))
    counts = np.zeros(CACHE_LINES)[:3]
    decay = medium.decay_constant(edges_mm[-1]) / sigma_t
    for start in range(0, n_photons, CHUNK):
        if stop.is_set():
            return None
        walk(
            min(CHUNK, n_photons - start),
            state,
            medium.sigma_s / sigma_t,
            medium.g,
            medium.eta,
            medium.vessel,
            beam.radius_mm * sigma_t,
            math.sin(math.radians(beam.incidence_deg)),
            decay,
            edges_mm * sigma_t,
            scores,
            paths,
            counts,
        )
    return scores, paths / sigma_t, counts


def _edges(r_edges_mm: ArrayLike) -> Floats:
    edges = np.asarray(r_edges_mm, dtype=np.float64)
    if (
        edges.ndim != 1
        or edges.size < 2
        or edges[0] != 0
        or not np.all(np.diff(edges) > 0)
        or not np.all(np.isfinite(edges))
    ):
        raise InputError("r_edges_mm must be finite, start at 0 and ascend: give at least [0, r]")
    return edges


def _mean_se(batches: Floats) -> tuple[Floats, Floats]:
    return batches.mean(0), batches.std(0, ddof=1) / math.sqrt(len(batches))


def _require(holds: bool, name: str, value: object, advice: str) -> None:
    if not holds:
        raise InputError(f"{name} = {value}: {advice}")
