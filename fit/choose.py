"""Which forward model fits a slice: the rule behind `--model auto`, and how far the dipole is off."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal

import jax
import jax.numpy as jnp

from bssrdf.errors import InputError
from bssrdf.transport.forward import DipoleModel, ForwardModel
from bssrdf.transport.table_cache import shipped, table_model

ModelName = Literal["auto", "dipole", "mc"]
Announce = Callable[[float], None]
ASSUMED_G = 0.0
"""Taken where a slice does not say g; the fit is flagged, since R depends on g at equal σs′."""

RULE = (
    "auto takes the dipole where its model error is below the statistical error in both coefficients, and the Monte "
    "Carlo table elsewhere. The dipole's model error is found by fitting it, with the same radii and weights, to the "
    "table's light of the same medium."
)


def tabulated(eta: float, g: float | None) -> bool:
    """Whether a table that ships with the package covers the medium, so that nothing has to be made first."""
    return shipped().covers(eta, ASSUMED_G if g is None else g)


def model_of(
    name: Literal["dipole", "mc"], eta: float, g: float | None, announce: Announce | None = None
) -> ForwardModel:
    """The forward model at (η, g); a table that does not ship is made first, `announce` being told for how long."""
    if name == "dipole":
        return DipoleModel(jnp.asarray(eta))
    return _on_device(eta, ASSUMED_G if g is None else g, announce)


@lru_cache(maxsize=64)
def _on_device(eta: float, g: float, announce: Announce | None) -> ForwardModel:
    try:
        model: Any = table_model(eta, g, announce=announce)
    except InputError as error:
        raise InputError(f"{error}; use --model dipole") from None
    return jax.tree.map(jnp.asarray, model)
