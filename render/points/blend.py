"""The light that leaves a closed body that is not flat: what walks find at some places mends what points find at all.

The kernel of points was made for a plane: round a bend and in a thin part too little light comes out. By how much
changes slowly along the surface, so that walks from few places tell it: the mean over a neighbourhood takes their noise
away, and the detail of points stays. How it changes their colour is told by wider neighbourhoods than how bright it is:
channels part in hundreds of scatterings, so that each has noise of its own, which would be seen as coloured patches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from bssrdf.render.points.record import BodySurface, Entered, Floats, Integers
from bssrdf.render.points.walk import Inside, Walked, walked
from bssrdf.render.surface_nets import body_size

_NEIGHBOURS = 160
"""Places in a mean, at most."""
_RADII = (4.0, 2.0, 1.0)
"""Of means, over the distance between places: about 200, 50 and 12 count."""
_WANTED = 0.015
"""Relative standard error at which half of what a narrower mean adds is believed."""
_TIMES = (16, 4, 1)
"""That the widest mean is taken of itself, for colour: as wide as four, two and one of it."""
_WANTED_COLOUR = 0.005
"""As _WANTED, of the colour: patches of 1 % are seen."""
PLACES = 6000
"""That walks start from, on a body that has room for more."""
_MORE = 16
"""Times as many walks from each place, at most, where places are fewer: noise else asks for means as wide as the body,
and balls of skin1 of three spreads were 18 % too bright in red on the dark side, 6 % too dark in blue all over."""
_BENT = 3e-4
"""Bend of a neighbourhood from which on walks count in full: that of a part ten times flatter than a ball, of which a
neighbourhood has 0.027 or more. Points miss two mean free paths over the radius, there a tenth of what they miss."""
_BETWEEN = 4
"""Places that a vertex lies between."""
_MOST_LOST = 0.1
"""Of what is added, by means over neighbourhoods: on a white cube of three mean free paths 0.7 %."""
_GRAZING = 0.05
"""Cosine to the viewer below which a place counts as unseen: little is transmitted there."""
_UNSEEN, _FEWEST = 8, 3
"""Of the walks one in so many, and so many, are enough where the viewer does not look. Places are not weighed by their
walks: those seen would speak for what lies round the bend, and the bust came out 1 % darker."""

Viewer = Callable[[Floats], Floats]
"""Unit vectors (k, 3) from places to whoever looks at them."""
Leaving = Callable[[Floats], Floats]
"""π times the radiance over the exitance at cosines (k,) to the normal, (k, channels)."""


@dataclass(frozen=True)
class Sampled:
    """What walks find at some places of a body, and where its form asks for them."""

    corners: Integers
    """Vertices of the triangle that each place is the middle of, (p, 3)."""
    places: Floats
    normals: Floats
    """(p, 3)."""
    bent: Floats
    """How far walks count there, from 0 where the body is flat and thick to 1, (p,)."""
    found: Walked | None
    """Where they count; None on a body that is flat and thick all over."""
    spacing: float
    """Between places."""


def sampled(
    surface: BodySurface,
    entered: Entered,
    inside: Inside,
    viewer: Viewer | None,
    leaving: Leaving,
    *,
    walks: int,
    seed: int = 0,
) -> Sampled:
    """Walks from places of a closed body.

    Args: walks: per channel, from each of the places. Where the viewer sees the body they find the exitance of which
    `leaving` makes the radiance towards them.
    """
    spacing = place_spacing(surface, inside)
    corners = surface.faces[sparse_faces(surface, spacing, seed)]
    places, normals = surface.vertices[corners].mean(axis=1), surface.normals[corners].mean(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    bent = np.minimum(_Near(places, normals, places, normals, _NEIGHBOURS).bend() / _BENT, 1)
    rows = np.flatnonzero(bent > 0)
    found = None
    if len(rows):
        most = round(walks * min(max(PLACES / len(rows), 1), _MORE))
        towards, cosine = _seen(places[rows], normals[rows], viewer)
        fewer = most if viewer is None else max(most // _UNSEEN, _FEWEST)
        number = np.where(cosine > 0, most, fewer)
        found = walked(surface, entered, inside, places[rows], normals[rows], towards=towards, walks=number, seed=seed)
        lobe = np.where(cosine[:, None] > 0, leaving(cosine), 1)
        found = Walked(found.mean / lobe, found.variance / lobe**2)
    return Sampled(corners, places, normals, bent, found, spacing)


def mended(surface: BodySurface, known: Sampled, exitance: Floats) -> Floats:
    """Radiant exitance of each vertex of a closed body, (n, channels), from that of points and what walks found.

    Where a body is flat and thick the light of points stays as it is.
    """
    found, places, normals, spacing = known.found, known.places, known.normals, known.spacing
    if found is None:
        return exitance
    rows = np.flatnonzero(known.bent > 0)
    bent = known.bent[rows, None]
    around = _Near(places[rows], normals[rows], places[rows], normals[rows], _NEIGHBOURS)
    missing = np.zeros((len(places), exitance.shape[1]))
    flat = exitance[known.corners[rows]].mean(axis=1)
    light = _tinted(around, found, flat, flat + _quiet(around, found, flat, spacing), spacing)
    missing[rows] = bent * (light - flat)
    between = _Near(places, normals, surface.vertices, surface.normals, _BETWEEN)
    change, areas = between.mean(missing, spacing / 2), surface.areas()
    asked = (between.nearest_sum(areas)[rows, None] * bent * (found.mean - flat)).sum(axis=0)
    return np.maximum(exitance + change * _kept(asked, areas @ change), 0)


def _kept(asked: Floats, given: Floats) -> Floats:
    """By channel, what brings the light that was added in all to that which walks ask for: means take from edges."""
    ratio = np.divide(asked, given, out=np.ones_like(asked), where=given != 0)
    return np.clip(ratio, 1 - _MOST_LOST, 1 + _MOST_LOST)


def _seen(places: Floats, normals: Floats, viewer: Viewer | None) -> tuple[Floats, Floats]:
    """The directions to the viewer and their cosines, 0 where the places are not seen."""
    towards = np.zeros_like(places) if viewer is None else viewer(places)
    cosine = np.einsum("ij,ij->i", towards, normals)
    cosine = np.where(cosine > _GRAZING, cosine, 0)
    return np.where(cosine[:, None] > 0, towards, 0), cosine


def _quiet(around: _Near, found: Walked, flat: Floats, spacing: float) -> Floats:
    """What points miss at each place, (k, channels): over so wide a neighbourhood as its noise asks for."""
    missing = found.mean - flat
    wide = around.mean(missing, _RADII[0] * spacing)
    for radius in _RADII[1:]:
        fine, noise = around.mean(missing, radius * spacing), around.variance(found.variance, radius * spacing)
        light = np.maximum(flat + fine, 0.1 * flat.mean(axis=0))
        trusted = 1 / (1 + (noise / np.square(_WANTED * light)).mean(axis=1, keepdims=True))
        wide = wide + trusted * (fine - wide)
    return wide


def _tinted(around: _Near, found: Walked, flat: Floats, light: Floats, spacing: float) -> Floats:
    """Light (k, channels) as bright as given, its colour that of points as walks change it over wide neighbourhoods.

    Done twice: what the walks' colour still differs by, and a wide mean took away, the second time brings back.
    """
    scale = np.maximum(flat.mean(axis=1, keepdims=True), 1e-3 * flat.mean() + 1e-30)  # the dark count as the bright do
    relative = Walked(found.mean / scale, found.variance / scale**2)
    bright = np.maximum(light.mean(axis=1, keepdims=True), 0)
    colour = flat
    for _ in range(2):
        colour = colour * _tint(around, relative, colour / scale, spacing)
        grey = colour.mean(axis=1, keepdims=True)
        colour = np.divide(bright * colour, grey, out=light.copy(), where=grey > 0)
    return colour


def _tint(around: _Near, walks: Walked, known: Floats, spacing: float) -> Floats:
    """The colour of walks over a known one, (k, channels): over so wide a neighbourhood as its noise asks for."""
    widths = [(_RADII[0], times) for times in _TIMES] + [(radius, 1) for radius in _RADII[1:]]
    tint = np.ones_like(known)
    for radius, times in widths:
        fine, noise = _ratio(around, walks, known, radius * spacing, times)
        trusted = 1 / (1 + noise / _WANTED_COLOUR**2) if (radius, times) != widths[0] else 1
        tint = tint + trusted * (fine - tint)
    return tint


def _ratio(around: _Near, walks: Walked, known: Floats, radius: float, times: int) -> tuple[Floats, Floats]:
    """Of means taken so many times, over its mean over channels, and its relative variance, (k, 1)."""
    variance = around.variance(walks.variance, radius) / times  # so many times the places count
    means = around.mean(np.hstack([walks.mean, known]), radius, times)
    above, below = np.hsplit(means, 2)
    ratio = np.divide(above, below, out=np.ones_like(above), where=below > 0)
    noise = np.divide(variance, above**2, out=np.zeros_like(above), where=above > 0)
    return ratio / np.maximum(ratio.mean(axis=1, keepdims=True), 1e-300), noise.mean(axis=1, keepdims=True)


def place_spacing(surface: BodySurface, inside: Inside) -> float:
    """A third of the way that light spreads, less where the body is small; so wide that PLACES are about enough."""
    area = float(surface.triangle_areas().sum())
    thickness = body_size(surface.vertices, surface.faces) / 3
    sigma_tp = inside.sigma_a + inside.sigma_sp
    spread = float(1 / np.sqrt(3 * inside.sigma_a * sigma_tp).max()) if inside.sigma_a.max() > 0 else np.inf
    fine = min(thickness, max(spread, 1.5 / float(sigma_tp.mean()))) / 3
    return max(fine, float(np.sqrt(area / PLACES)))


class _Near:
    """The places near others, on their side of the body."""

    def __init__(self, places: Floats, normals: Floats, at: Floats, facing: Floats, most: int) -> None:
        self._places = len(places)
        self._apart, self._near = cKDTree(places).query(at, range(1, min(most, len(places)) + 1))
        self._cosines = np.einsum("ijk,ik->ij", normals[self._near], facing)
        self._aligned = np.maximum(self._cosines, 1e-6)
        self._known: dict[float, csr_array] = {}

    def nearest_sum(self, values: Floats) -> Floats:
        """Of values (k,) over what each place is nearest to, (places,)."""
        return np.asarray(np.bincount(self._near[:, 0], values, self._places))

    def bend(self) -> Floats:
        """Mean of 1 less the cosine between the normals, (k,): 0 on a plane, 2 where a thin part's other side is."""
        return np.asarray(1 - self._cosines.mean(axis=1))

    def mean(self, values: Floats, radius: float, times: int = 1) -> Floats:
        """Of means, where it is taken more times than once."""
        weights = self._weights(radius)
        for _ in range(times):
            values = np.asarray(weights @ values)
        return values

    def variance(self, values: Floats, radius: float) -> Floats:
        """Of the mean, from those of independent values."""
        return np.asarray(self._weights(radius).power(2) @ values)

    def _weights(self, radius: float) -> csr_array:
        if radius not in self._known:
            self._known[radius] = self._weighted(radius)
        return self._known[radius]

    def _weighted(self, radius: float) -> csr_array:
        nearest = self._apart[:, :1]
        weight = self._aligned * np.exp(-0.5 * (np.square(self._apart) - np.square(nearest)) / radius**2)
        weight /= weight.sum(axis=1, keepdims=True)
        rows, most = weight.shape
        indices = self._near.flatten()  # a copy: it is sorted in place
        return csr_array((weight.ravel(), indices, np.arange(rows + 1) * most), (rows, self._places))


def sparse_faces(surface: BodySurface, spacing: float, seed: int) -> Integers:
    """One face of each cube of that side through which the surface runs, drawn by area."""
    centres = surface.vertices[surface.faces].mean(axis=1)
    cube = np.floor(centres / spacing).astype(np.int64)
    cube -= cube.min(axis=0)
    late = np.random.default_rng(seed).exponential(size=len(centres)) / np.maximum(surface.triangle_areas(), 1e-300)
    order = np.argsort(late)
    _, first = np.unique(np.ravel_multi_index(tuple(cube[order].T), cube.max(axis=0) + 1), return_index=True)
    return np.asarray(order[first], np.int64)
