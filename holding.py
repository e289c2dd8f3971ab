"""How a slice's sample is held: its depth, back and wall as the fit takes them, and what was assumed of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.records import Slice
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.finite import DEEP, Kind, Sample, log_ratio, top_of
from bssrdf.transport.light import Light, shape_of
from bssrdf.transport.slab import FARTHEST, air_back

THICKNESS_REL_SD = 0.02
"""Assumed where none is stated: half a millimetre of 25 by a ruler."""
NEAR_TOTAL = 0.01
"""An index so near to total reflection is taken for it: its neighbours, by which slopes are found, may be beyond."""
BLACK, BLACK_SD = 0.03, 0.03
"""Of black paint, felt or anodised metal."""
BACKING_SD = 0.05
"""Assumed of a reflectance that is stated without an error."""
NEAR_WALL = 0.85
"""Of a dish's radius: farther out, within a mean free path or two of its wall, light is not diffuse."""
STEEP_DEG = 10.0
"""Of the beam to the normal: from here on the ratio of `transport.finite` does not hold."""


class Held(NamedTuple):
    """Lengths in mm, infinite where there is nothing; reflectances diffuse."""

    kind: Kind
    thickness: float = math.inf
    back: float = 0.0
    radius: float = math.inf
    wall: float = 0.0
    thickness_rel_sd: float = 0.0
    back_sd: float = 0.0

    @property
    def reach(self) -> float:
        """The farthest radius at which the ratio to a half space is known."""
        return min(NEAR_WALL * self.radius, FARTHEST * self.thickness)

    @property
    def on_black(self) -> bool:
        """Whether what passes the sample is lost for the most part."""
        return self.back < 0.5


HALF_SPACE = Held("half")


def held(piece: Slice) -> Held:
    """What the fit allows for; a back or wall that is not known is left out, and flagged in the verdict.

    Raises InputError where the keys contradict each other.
    """
    _possible(piece)
    if piece.incidence_deg >= STEEP_DEG:
        return HALF_SPACE
    deep = piece.thickness_mm is None or _back(piece) is None
    round_ = piece.width_mm is not None and piece.wall is not None
    if deep and not round_:
        return HALF_SPACE
    back, back_sd = _back(piece) or (0.0, 0.0)
    thickness = math.inf if deep else float(piece.thickness_mm or math.inf)
    sd = THICKNESS_REL_SD if piece.thickness_sd_mm is None else piece.thickness_sd_mm / thickness
    return Held(
        "dish" if round_ else "slab",
        thickness,
        0.0 if deep else back,
        float(piece.width_mm or math.inf) / 2 if round_ else math.inf,
        air_back(piece.eta) if round_ and piece.wall == "air" else 0.0,
        0.0 if deep else sd,
        0.0 if deep else back_sd,
    )


def assumed(piece: Slice) -> tuple[bool, bool]:
    """Whether the error of the thickness, and the back or its error, were assumed."""
    if held(piece).thickness == math.inf:
        return False, False
    number = not isinstance(piece.backing, str)
    return piece.thickness_sd_mm is None, piece.backing == "black" or (number and piece.backing_sd is None)


def _back(piece: Slice) -> tuple[float, float] | None:
    """Diffuse reflectance of the back and its error; None where it is not known."""
    if piece.backing == "air":
        return air_back(piece.eta), 0.0
    if piece.backing == "black":
        return BLACK, BLACK_SD if piece.backing_sd is None else piece.backing_sd
    if piece.backing is None or isinstance(piece.backing, str):
        return None
    return piece.backing, BACKING_SD if piece.backing_sd is None else piece.backing_sd


def _possible(piece: Slice) -> None:
    angles = {"incidence_deg": piece.incidence_deg}
    if piece.exit == "fresnel":
        angles["view_angle_deg"] = piece.view_angle_deg
    for key, angle in angles.items():
        if piece.eta < 1 and math.sin(math.radians(angle)) > piece.eta - NEAR_TOTAL:
            raise InputError(
                f"eta = {piece.eta:g} with {key} = {angle:g}: there a boundary of that index reflects all light; "
                "correct one of them"
            )
    if piece.wall is not None and piece.width_mm is None:
        raise InputError(f'wall = "{piece.wall}": give width_mm, the inner diameter of the dish, too')
    spot = piece.spot_radius_mm or 0.0
    if piece.thickness_mm is not None and piece.thickness_mm <= spot:
        raise InputError(
            f"thickness_mm = {piece.thickness_mm:g} is no more than the spot's radius of {spot:g} mm; no model "
            "knows such a sample: take a narrower beam"
        )
    if piece.width_mm is not None and piece.width_mm <= 2 * spot:
        raise InputError(f"width_mm = {piece.width_mm:g} is no wider than the spot; take a narrower beam")


def samples_of(pieces: Sequence[Slice]) -> Sample:
    """Of slices of one kind, (b, 1) each; a dish no deeper than its wall lets light return from."""
    every = [held(piece) for piece in pieces]
    deep = [min(each.thickness, DEEP * each.radius) for each in every]
    return Sample(*(np.array(each)[:, None] for each in (deep, *zip(*(e[2:5] for e in every), strict=True))))


def sample_ratio(
    piece: Slice, model: Light, sigma_a: float, sigma_sp: float, r_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What back and walls of the slice's sample make of a half space's curve at these radii, (n,); 1 without them."""
    kind = held(piece).kind
    if kind == "half":
        return np.ones_like(r_mm)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    looked = log_ratio(NUMPY, kind == "dish", samples_of([piece]), top_of(model), log_sigma, q, r_mm[None])
    ratio: NDArray[np.float64] = np.exp(looked[0][0])
    return ratio
