"""How the beam meets the surface, and the light that an oblique beam gives after one scattering. Lengths in 1/σt.

NumPy alone, as `white.assembly` needs it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.transport.exit_radiance import transmittance

Floats = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(160)
_U, _DU = (1 + _NODES) / 2, _WEIGHTS / 2
_SMOOTH, _D_SMOOTH = _U**2 * (3 - 2 * _U), 6 * _U * (1 - _U) * _DU
"""Nodes that crowd at both ends: where light comes back along the beam, and where it leaves along the surface."""
N_AZIMUTHS = 24
"""Over half a turn, for means over all."""


class Incidence(NamedTuple):
    """A beam's angle, and which radii are meant: its light is not the same on all sides."""

    angle_deg: float = 0.0
    """Against the normal, outside."""
    across: bool = False
    """Radii at a right angle to the plane of incidence, else the mean over all azimuths."""

    @property
    def sine(self) -> float:
        return math.sin(math.radians(self.angle_deg))


NORMAL = Incidence()


class Once(NamedTuple):
    """Light scattered once by azimuth of its place, per σs/σt."""

    light: Floats
    """ρ R⁽¹⁾ e^(decay ρ) at the radii asked for."""
    decay: float
    """The least attenuation of a radius of 1."""
    total: float
    """∫ R⁽¹⁾ dA, over all azimuths."""


def once_scattered(eta: float, g: float, beam: Incidence, rho: Floats) -> Once:
    """Light that an oblique beam gives after one scattering, at radii about the place where the beam meets the surface.

    Scattered after the path t towards a cosine μ′ upwards, light leaves at t V(τ, φ′) = t (s + c τ cos φ′, c τ sin φ′)
    with τ the tangent of the angle, s and c sine and cosine of the beam inside. A place at radius ρ and azimuth φ takes
    the light of all t = ρ/v, |V| = v; dΩ′ = μ′³ dA_V/c². As `single.first_order_bin_average` for a normal beam.
    """
    sine = beam.sine / eta
    cosine = math.sqrt(1 - sine * sine)
    one = beam.across or sine == 0
    azimuths = [math.pi / 2] if one else ((np.arange(N_AZIMUTHS) + 0.5) * math.pi / N_AZIMUTHS).tolist()
    parts = [_towards(eta, g, sine, cosine, azimuth) for azimuth in azimuths]
    decay = min(float(attenuation.min()) for _, attenuation in parts)
    light = sum(np.exp(-(attenuation - decay) * rho[:, None]) @ leaving for leaving, attenuation in parts)
    return Once(np.asarray(light) / len(parts), decay, _total(eta, g, sine, cosine))


def _towards(eta: float, g: float, sine: float, cosine: float, azimuth: float) -> tuple[Floats, Floats]:
    """At nodes in v: p Ft μ′³ dv/c², and the attenuation by a radius of 1."""
    steepest = eta * eta - 1  # tan² of the critical angle is 1/steepest
    along = sine * math.cos(azimuth)
    reach = (cosine**2 - sine**2 * steepest + along**2 * steepest) / steepest if steepest > 0 else math.inf
    farthest = along + math.sqrt(reach) if steepest > 0 else math.inf
    last = math.atan(farthest)
    v, dv = np.tan(last * _SMOOTH), last * _D_SMOOTH / np.cos(last * _SMOOTH) ** 2
    tangent2 = np.maximum(v * v - 2 * v * along + sine**2, 0) / cosine**2
    mu = 1 / np.sqrt(1 + tangent2)
    cos_theta = sine * mu * (v * math.cos(azimuth) - sine) / cosine - cosine * mu
    leaving = _phase(g, cos_theta) * _passed(eta, mu) * mu**3 * dv / cosine**2
    return leaving, (1 + cosine / mu) / v


def _total(eta: float, g: float, sine: float, cosine: float) -> float:
    """Share of the light that leaves after one scattering, over all directions, per σs/σt."""
    outside = math.pi / 2 * _SMOOTH
    sine_out = np.sin(outside) / eta
    mu = np.sqrt(1 - sine_out**2)
    azimuth = (np.arange(64) + 0.5) * math.pi / 64
    cos_theta = sine * sine_out[:, None] * np.cos(azimuth) - (cosine * mu)[:, None]
    solid = 2 * math.pi * sine_out * np.cos(outside) / (eta * mu) * math.pi / 2 * _D_SMOOTH
    mean = _phase(g, cos_theta).mean(axis=1)
    return float(np.sum(mean * _passed(eta, mu) * mu / (mu + cosine) * solid))


def _phase(g: float, cos_theta: Floats) -> Floats:
    return np.asarray((1 - g * g) / (4 * math.pi) * (1 + g * g - 2 * g * cos_theta) ** -1.5)


def _passed(eta: float, mu: Floats) -> Floats:
    """Fresnel's transmittance at the cosine inside, 0 beyond the critical angle."""
    outside2 = 1 - eta * eta * (1 - mu * mu)
    return np.where(outside2 > 0, transmittance(eta, np.sqrt(np.maximum(outside2, 0))), 0.0)
