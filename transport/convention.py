"""The one place where a model's value becomes what a camera sees, and back. Dimensionless; angles in degrees."""

from __future__ import annotations

import math

import numpy as np

from bssrdf.errors import InputError
from bssrdf.transport.light import exit_norm, transmittance

FLUXES = ("incident", "entering")
EXITS = ("hemisphere", "lambertian", "fresnel")


def camera_factor(
    eta: float,
    *,
    flux: str,
    exit: str,  # noqa: A002
    view_angle_deg: float,
    incidence_deg: float,
) -> float:
    """A value in the given convention over the model's own (flux "entering", exit "hemisphere").

    The same factor holds for R_d and for the total R. Flux "incident" brings Ft(eta, incidence), exit "fresnel"
    Ft(eta, view)/C with C = `exit_norm(eta)`; everything else brings 1. Angles are measured from the normal.
    Raises InputError for an unknown name or a value out of range.
    """
    _require(flux in FLUXES, f'flux = "{flux}"', 'use "incident" or "entering"')
    _require(exit in EXITS, f'exit = "{exit}"', 'use "hemisphere", "lambertian" or "fresnel"')
    _require(math.isfinite(eta) and eta > 0, f"eta = {eta}", "give a relative index of refraction above 0")
    for name, angle in {"view_angle_deg": view_angle_deg, "incidence_deg": incidence_deg}.items():
        _require(0 <= angle < 90, f"{name} = {angle}", "give an angle from 0 to below 90")
    factor = 1.0
    if flux == "incident":
        factor *= _transmittance(eta, incidence_deg)
    if exit == "fresnel":
        factor *= _transmittance(eta, view_angle_deg) / exit_norm(eta)
    return factor


def _transmittance(eta: float, angle_deg: float) -> float:
    return float(transmittance(np, eta, math.cos(math.radians(angle_deg))))


def _require(holds: bool, value: str, remedy: str) -> None:
    if not holds:
        raise InputError(f"{value}: {remedy}")
