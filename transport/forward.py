"""The seam between what scatters light and what needs it: fits, figures and the bench see a forward model only.

A model is a pytree at one (η, g), so that one compiled function serves every model of a kind. Values are per unit flux
that entered the medium, over the hemisphere of exit directions; lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

from jaxtyping import Array, Float

from bssrdf.transport import dipole
from bssrdf.transport.dipole import Medium
from bssrdf.transport.fresnel import exit_norm, fresnel_t
from bssrdf.transport.precision import Real


class Azimuths(NamedTuple):
    """The angles φ about the normal between radius and camera over which light is averaged."""

    cos_2: Real
    """Mean of cos 2φ."""
    along: Real
    """Share of φ = 0 in the average, over its share in that of a whole circle."""


WHOLE_CIRCLE = Azimuths(0.0, 1.0)
ACROSS = Azimuths(-1.0, 0.0)
"""Radius at a right angle to the camera's plane of view."""


@runtime_checkable
class ForwardModel(Protocol):
    """R_d(r) of a semi-infinite medium; safe under jit, vmap and grad, in the medium and in the radii."""

    @property
    def name(self) -> str:
        """`dipole` or `mc`."""
        ...

    @property
    def eta(self) -> Real:
        """Relative index of refraction that the model was made for."""
        ...

    @property
    def q_max(self) -> float:
        """Largest q = √(3σa/σt′) that the model knows."""
        ...

    @property
    def window_mfp(self) -> tuple[float, float]:
        """Radii in mean free paths 1/σt′ between which a fit may trust it."""
        ...

    def rd(self, medium: Medium, r: Real) -> Float[Array, "..."]:
        """R_d(r) [1/mm²]."""
        ...

    def bin_average(self, medium: Medium, r_lo: Real, r_hi: Real) -> Float[Array, "..."]:
        """Mean of R_d over the annulus [r_lo, r_hi], weighted by r dr."""
        ...

    def total(self, medium: Medium) -> Float[Array, "..."]:
        """Total diffuse reflectance."""
        ...

    def radiance(self, medium: Medium, r: Real, mu: Real, azimuths: Azimuths) -> Float[Array, "..."]:
        """π L [1/mm²] at radius r towards the outside cosine `mu`, a mean over `azimuths`: R_d if Lambertian."""
        ...

    def total_radiance_factor(self, medium: Medium, mu: Real) -> Float[Array, "..."]:
        """π L/R over the whole surface towards the outside cosine `mu`."""
        ...


class DipoleModel(NamedTuple):
    """The paper's dipole. It holds where light has been scattered a few times: from one mean free path on."""

    eta: Real

    @property
    def name(self) -> str:
        return "dipole"

    @property
    def q_max(self) -> float:
        return 1.73  # α′ = 0.002

    @property
    def window_mfp(self) -> tuple[float, float]:
        return (1.0, 24.0)

    def rd(self, medium: Medium, r: Real) -> Float[Array, "..."]:
        return dipole.rd(medium, r)

    def bin_average(self, medium: Medium, r_lo: Real, r_hi: Real) -> Float[Array, "..."]:
        return dipole.bin_average(medium, r_lo, r_hi)

    def total(self, medium: Medium) -> Float[Array, "..."]:
        return dipole.total_r(medium)

    def radiance(self, medium: Medium, r: Real, mu: Real, azimuths: Azimuths) -> Float[Array, "..."]:
        """Ft/C of R_d at every radius and azimuth: the paper's exit law, normalised."""
        return self.rd(medium, r) * self.total_radiance_factor(medium, mu)

    def total_radiance_factor(self, medium: Medium, mu: Real) -> Float[Array, "..."]:
        return fresnel_t(medium.eta, mu) / exit_norm(medium.eta)
