"""What spot and camera make of the curve: the model's R_d(r) is that of a narrow beam, over all directions of exit."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.fit.curves import Curves
from bssrdf.fit.predict import Parameters, Scalar, medium_of
from bssrdf.fit.spot import Radii, blur
from bssrdf.transport.forward import Azimuths, DipoleModel, ForwardModel

_DARKEST = 1e-6
"""What the exit law falls to at least, where it is a fit that may run below 0 right at the beam."""


class Seen(NamedTuple):
    """The ratio of what is seen to the model's curve, near the point where it was last worked out."""

    log_ratio: Float[Array, " n"]
    """ln of what is seen over a narrow beam's curve and Fresnel's exit law."""
    slopes: Float[Array, "2 n"]
    """Its derivatives in ln σt′ and q: within a mean free path it goes with the radius as fast as the curve does."""
    log_sigma_tp: Scalar
    q: Scalar

    def ratio(self, point: Parameters) -> Float[Array, " n"]:
        """At a point nearby; steps of more than a factor of e are cut short."""
        by_log_sigma, by_q = self.slopes
        ahead = by_log_sigma * (point.log_sigma_tp - self.log_sigma_tp) + by_q * (point.q - self.q)
        return jnp.exp(self.log_ratio + jnp.clip(ahead, -1, 1))


def as_it_is(like: Float[Array, " n"], point: Parameters) -> Seen:
    """A narrow beam, seen over all directions."""
    return Seen(jnp.zeros_like(like), jnp.zeros((2, *like.shape), like.dtype), point.log_sigma_tp, point.q)


def seen_at(model: ForwardModel, data: Curves, point: Parameters, *, blurred: bool, camera: bool) -> Seen:
    """The ratio at `point`, by the spot where `blurred`, by the camera's angle where `camera`."""
    centre = jnp.maximum((data.r_lo + data.r_hi) / 2, jnp.finfo(data.r_lo.dtype).eps)

    def log_ratio(shape: Float[Array, " 2"]) -> tuple[Radii, Radii]:
        medium = medium_of(model, point._replace(log_sigma_tp=shape[0], q=shape[1]))
        law = DipoleModel(model.eta).total_radiance_factor(medium, data.cos_view)

        def light(r: Radii, sin_turn: Radii) -> Radii:
            if not camera:
                return model.rd(medium, r)
            return model.radiance(medium, r, data.cos_view, azimuths(data.arc, sin_turn)) / law

        seen = blur(light, centre, data.spot_radius) if blurred else light(centre, jnp.zeros_like(centre))
        value = jnp.log(jnp.maximum(seen / model.rd(medium, centre), _DARKEST))
        return value, value

    slopes, value = jax.jacfwd(log_ratio, has_aux=True)(jnp.stack([point.log_sigma_tp, point.q]))
    return Seen(value, slopes.T, point.log_sigma_tp, point.q)


def exit_rel_sd(model: ForwardModel, data: Curves, point: Parameters) -> Radii:
    """What the exit law may be off by at each radius; all azimuths together it is known better."""
    mfp = jnp.exp(-point.log_sigma_tp)
    centre = jnp.maximum((data.r_lo + data.r_hi) / 2, 1e-3 * mfp)
    return model.exit_error_mfp * mfp / centre * jnp.abs(jnp.sinc(2 * data.arc / jnp.pi))


def azimuths(arc: Radii, sin_turn: Radii) -> Azimuths:
    """Azimuths between light and camera where a bin's pixels lie within ±`arc` [rad] of the line across the view.

    `sin_turn` is that of the angle between the pixel's radius from the spot's centre and from where its light entered.
    """
    along = jnp.abs(sin_turn) > jnp.cos(arc) - 1e-6
    return Azimuths(
        cos_2=(2 * jnp.square(sin_turn) - 1) * jnp.sinc(2 * arc / jnp.pi),
        along=jnp.where((arc > 0) & along, jnp.pi / 2 / jnp.maximum(arc, 0.1), 0.0),
    )
