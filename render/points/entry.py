"""Light that enters a body, as walks inside meet it: even light, and beside it a beam along the direction stored.

Flux that enters is told by the sine s of its direction inside, a vector along the surface: even light fills the disc
|s| < 1/η by Fresnel's transmittance; of a beam it is a point, for walks a small disc about it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from bssrdf.render.kernel import cosines
from bssrdf.render.points.leap import RoomGrid
from bssrdf.render.points.record import BodySurface, Entered, Floats

BEAM = 0.4
"""Radius of a beam's disc over that of even light: in literal balls rings are then right within 3 % where lit, by 0.7
within 6 %; the noise of walks goes as its square's inverse."""
CONCENTRATION = 20.0
"""Of the directions about the light's in which walks look for it (von Mises and Fisher): as wide as the disc."""
_LEAST = 0.2
"""Share of a beam in the light of a neighbourhood below which walks do not look for it: even light has none."""


@dataclass(frozen=True)
class EntryLobes:
    """Of each vertex."""

    share: Floats
    """Of the flux that comes by the beam, (n,)."""
    beam: Floats
    """Unit vector along which that runs inside, (n, 3)."""


def even_norm(transmitted: Floats) -> float:
    """C = 2 ∫ T μ dμ of transmittances over `cosines()`."""
    mu = cosines()
    return float(2 * np.trapezoid(transmitted * mu, mu))


def entry_lobes(surface: BodySurface, entered: Entered, eta: float, transmitted: Floats) -> EntryLobes:
    """Even light and a beam that together have the mean direction stored.

    Of even light the mean lies along the normal; from there through the one stored the beam is the unit sphere's.
    """
    mu = cosines()
    inside = np.sqrt(1 - (1 - mu**2) / eta**2)
    even = float(np.trapezoid(transmitted * mu * inside, mu) / np.trapezoid(transmitted * mu, mu))
    off = entered.direction + even * surface.normals
    square = np.maximum(np.einsum("ij,ij->i", off, off), 1e-12)
    along = -even * np.einsum("ij,ij->i", off, surface.normals)
    length = (np.sqrt(along**2 + square * (1 - even**2)) - along) / square
    return EntryLobes(np.minimum(1 / length, 1), length[:, None] * off - even * surface.normals)


class EntryLight:
    """The light of a surface as Dr.Jit arrays, over C/π times η² times the radiance that it has inside."""

    def __init__(self, surface: BodySurface, entered: Entered, eta: float, transmitted: Floats, room: RoomGrid) -> None:
        lobes = entry_lobes(surface, entered, eta, transmitted)
        radius = BEAM / eta
        sideways = lobes.beam - np.einsum("ij,ij->i", lobes.beam, surface.normals)[:, None] * surface.normals
        sine = np.linalg.norm(sideways, axis=1)
        sideways *= np.minimum(1, min(1 / eta, 1 - radius / 2) / np.maximum(sine, 1e-12))[:, None]
        possible = _share_within_unit_circle(np.linalg.norm(sideways, axis=1), radius)
        dense = even_norm(transmitted) * lobes.share / (BEAM**2 * possible)
        flux = surface.areas() * entered.fresnel.sum(axis=1)
        along = (lobes.share * flux)[:, None] * lobes.beam
        self._square = radius**2
        self._channels = entered.fresnel.shape[1]
        self._even = as_floats((1 - lobes.share)[:, None] * entered.fresnel)
        self._beam = as_floats(dense[:, None] * entered.fresnel)
        self._sideways = as_floats(sideways)
        self._guides = as_floats(room.nearest_beam(surface.vertices, along, flux, _LEAST))

    def even(self, corners: list[Any], weights: tuple[Any, ...], channel: Any, active: Any) -> Any:
        """Between the corners, to be multiplied by Fresnel's transmittance."""
        return _mixed(lambda corner: self._read(self._even, corner, channel, active), corners, weights)

    def beam(self, corners: list[Any], weights: tuple[Any, ...], channel: Any, way: Any, n: Any, active: Any) -> Any:
        """Between the corners, where a walk meets the surface of normal `n` along a way, against the light.

        The discs of the corners are laid on the surface there: on one that is bent they would hold less of the light.
        """

        def of(corner: Any) -> Any:
            off = as_vector(self._sideways, corner, active) + way
            near = dr.squared_norm(off - dr.dot(off, n) * n) < self._square
            return dr.select(near, self._read(self._beam, corner, channel, active), 0)

        return _mixed(of, corners, weights)

    def towards(self, cell: Any, active: Any) -> Any:
        """Unit vector against the beam nearest to a cell of the room, 0 where there is none."""
        return -as_vector(self._guides, cell, active)

    def _read(self, values: Any, corner: Any, channel: Any, active: Any) -> Any:
        return dr.gather(mi.Float, values, corner * self._channels + channel, active)


def _share_within_unit_circle(off: Floats, radius: float) -> Floats:
    """Of the area of discs whose centres lie `off` its middle."""
    d = np.maximum(off, 1e-9)
    own = np.clip((d * d + radius**2 - 1) / (2 * d * radius), -1, 1)
    unit = np.clip((d * d + 1 - radius**2) / (2 * d), -1, 1)
    kite = (radius + 1 - d) * (d + radius - 1) * (d - radius + 1) * (d + radius + 1)
    lens = radius**2 * np.arccos(own) + np.arccos(unit) - np.sqrt(np.maximum(kite, 0)) / 2
    return np.asarray(np.where(d + radius <= 1, 1, lens / (math.pi * radius**2)))


def as_floats(values: Any) -> Any:
    """Numbers of any shape as one row of Dr.Jit's."""
    return mi.Float(np.ascontiguousarray(values, np.float32).ravel())


def as_vector(row: Any, index: Any, active: Any) -> Any:
    """The vectors of a row at an index."""
    return mi.Vector3f(*(dr.gather(mi.Float, row, 3 * index + i, active) for i in range(3)))


def _mixed(value: Any, corners: list[Any], weights: tuple[Any, ...]) -> Any:
    first, second, third = (weight * value(corner) for weight, corner in zip(weights, corners, strict=True))
    return first + second + third
