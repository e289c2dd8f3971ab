"""Both forward models in reduced form, R_d(r) = σt′² F(q, x), x = σt′ r, q = √(3σa/σt′), with slopes written out.

Each text runs on NumPy or JAX (`arrays`). Shapes: q is (b, 1), x is (b, n); a look is (F, ∂F/∂ln x, ∂F/∂q). Per unit
flux that entered, over the hemisphere of exits. Light is even in q, and the total odd about R = 1, so that a fit may
pass q = 0 on its way.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from bssrdf.transport.arrays import Engine
from bssrdf.transport.splines import cubic, cubic_value, locate, powers_at, spline, spline_rows
from bssrdf.transport.white.grid import Q_MAX, Q_ZERO, R_MAX, R_ZERO, RHO_ZERO, U_MAX, V_MAX, W_MAX

SMALLEST_Q = 1e-12
"""In place of 0, where √ has no slope; σa/σt′ is then 3e-25."""
NEAREST_MFP = 1e-3
"""Radii nearer than this are looked at here: light scattered once goes as 1/r."""
_EPS = float(np.finfo(float).eps)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_U = (1 + _NODES) / 2

Look = tuple[Any, Any, Any]


class Light(Protocol):
    """What a fit asks of a model of light in a half space."""

    @property
    def eta(self) -> float: ...

    @property
    def name(self) -> str: ...

    @property
    def q_max(self) -> float: ...

    @property
    def window_mfp(self) -> tuple[float, float]:
        """Radii in mean free paths 1/σt′ between which a fit may trust it."""
        ...

    @property
    def relative_error(self) -> float:
        """How far its curve may be off at a typical radius: what a radius's weight allows for."""
        ...

    @property
    def biased(self) -> bool:
        """Whether that error is the model's own, one for all curves, and not noise that an interval can hold."""
        ...

    @property
    def exit_varies(self) -> bool:
        """Whether what a camera sees falls off otherwise than R_d."""
        ...

    @property
    def exit_error(self) -> float:
        """How far its radiance across the view may be off relative to that, at all radii together."""
        ...

    @property
    def exit_error_mfp(self) -> float:
        """The same at each radius for itself, times the radius in mean free paths."""
        ...

    def look(self, e: Engine, q: Any, x: Any) -> Look:
        """F and its slopes."""
        ...

    def total(self, e: Engine, q: Any) -> tuple[Any, Any]:
        """R and dR/dq."""
        ...

    def radiance(self, e: Engine, q: Any, x: Any, mu: float, cos_2: Any, along: Any) -> Look:
        """π L/σt′² towards the outside cosine `mu`, and slopes; see `forward.Azimuths` for the averages."""
        ...

    def total_radiance_factor(self, e: Engine, q: Any, mu: float) -> Any:
        """π L/R over the whole surface."""
        ...

    def first_by_side(self, e: Engine, q: Any, x: Any, mu: float) -> tuple[Any, Any]:
        """What light scattered once owes to a camera's azimuth about an oblique beam; see `WhiteTable`."""
        ...

    def shape_sd(self, e: Engine, q: Any, x: Any) -> Any:
        """Relative standard error of F by the model's own noise."""
        ...


class Dipole(NamedTuple):
    """Eq. 4 of Jensen et al. 2001 in units of σt′."""

    eta: float
    a: float
    """A = (1 + Fdr)/(1 − Fdr)."""
    name: str = "dipole"
    q_max: float = 1.73  # α′ = 0.002
    window_mfp: tuple[float, float] = (1.0, 24.0)
    relative_error: float = 0.05
    biased: bool = True
    exit_varies: bool = False
    exit_error: float = 0.0  # nothing beside its other errors
    exit_error_mfp: float = 0.0

    def look(self, e: Engine, q: Any, x: Any) -> Look:
        xp = e.xp
        aq = xp.maximum(xp.abs(q), SMALLEST_Q)
        albedo, x2 = 1 - aq * aq / 3, x * x
        value = by_x = by_q = 0.0
        for z in (1.0, 1 + 4 / 3 * self.a):
            d2 = x2 + z * z
            d = xp.sqrt(d2)
            y = aq * d
            pulse = z * xp.exp(-y) / (d2 * d)
            bent = y * pulse
            flux = pulse + bent
            value = value + flux
            by_x = by_x - x2 / d2 * (3 * flux + y * bent)
            by_q = by_q - d * bent
        k = albedo / (4 * np.pi)
        return k * value, k * by_x, xp.sign(q) * (k * by_q - aq / (6 * np.pi) * value)

    def total(self, e: Engine, q: Any) -> tuple[Any, Any]:
        """R = α′/2 (1 + e^(−4/3 A q)) e^(−q)."""
        xp = e.xp
        aq, k = xp.abs(q), 4 / 3 * self.a
        virtual, real, albedo = xp.exp(-k * aq), xp.exp(-aq), 1 - aq * aq / 3
        inside = albedo / 2 * (1 + virtual) * real
        slope = -real * (aq / 3 * (1 + virtual) + albedo / 2 * (1 + virtual + k * virtual))
        return xp.where(q >= 0, inside, 2 - inside), slope

    def radiance(self, e: Engine, q: Any, x: Any, mu: float, cos_2: Any, along: Any) -> Look:
        """Ft/C of R_d at every radius and azimuth: the paper's exit law, normalised."""
        law = transmittance(np, self.eta, mu) / exit_norm(self.eta)
        value, by_x, by_q = self.look(e, q, x)
        return law * value, law * by_x, law * by_q

    def total_radiance_factor(self, e: Engine, q: Any, mu: float) -> Any:
        return e.xp.zeros_like(q) + transmittance(np, self.eta, mu) / exit_norm(self.eta)

    def first_by_side(self, e: Engine, q: Any, x: Any, mu: float) -> tuple[Any, Any]:
        return 0 * x, 0 * x

    def shape_sd(self, e: Engine, q: Any, x: Any) -> Any:
        return e.xp.zeros_like(q * x)


class WhiteTable(NamedTuple):
    """The white Monte Carlo table of one η and g; see `white.assembly` for the arrays."""

    eta: float
    g: float
    log_curve: Any
    log_curve_sd: Any
    diffusion_ratio: Any
    log_total: Any
    first: Any
    first_decay: Any
    angles: Any
    total_angles: Any
    name: str = "mc"
    q_max: float = float(np.sqrt(3) * Q_MAX)
    window_mfp: tuple[float, float] = (0.0, 0.95 * R_MAX)  # a fit's window fades out about its end
    relative_error: float = 0.003
    biased: bool = False
    exit_varies: bool = True
    exit_error: float = 0.005
    exit_error_mfp: float = 0.008  # docs/white-tables.md
    sin_beam: float = 0.0
    """Of the beam's angle to the normal, inside."""

    def look(self, e: Engine, q: Any, x: Any) -> Look:
        return _added(self._multiple(e, q, x), self._first(e, q, x))

    def total(self, e: Engine, q: Any) -> tuple[Any, Any]:
        xp = e.xp
        aq = xp.maximum(xp.abs(q), SMALLEST_Q)
        albedo = 1 - aq * aq / 3
        u, u_q = _u(xp, aq)
        loss, by_u = spline(e, self.log_total[None], u)
        inside = albedo * xp.exp(-loss)
        return xp.where(q >= 0, inside, 2 - inside), -inside * (2 * aq / 3 / albedo + by_u * u_q)

    def _multiple(self, e: Engine, q: Any, x: Any) -> Look:
        """Light scattered twice or more: α′² e^S (1 + y) e^(−y), y = κx, κ² = q² × `diffusion_ratio`."""
        xp = e.xp
        aq = xp.maximum(xp.abs(q), SMALLEST_Q)
        albedo = 1 - aq * aq / 3
        u, u_q = _u(xp, aq)
        ratio, ratio_u = spline(e, self.diffusion_ratio[None], u)
        kappa_q = 1 / aq + ratio_u * u_q / (2 * ratio)  # of ln κ
        row, row_u = spline_rows(xp, self.log_curve, u[:, 0])
        n = row.shape[-1]
        v = xp.log1p(x / R_ZERO) * (n / V_MAX)
        inside = xp.minimum(v, n)
        cell, f = locate(xp, inside, n)
        smooth, smooth_v = cubic(e.take(row, cell), f)
        smooth_u = cubic_value(e.take(row_u, cell), f)
        beyond = inside - v  # diffusing light goes on as the cube of the radius
        y = aq * xp.sqrt(ratio) * x
        fallen = xp.exp(smooth + 3 * V_MAX / n * beyond - y + 2 * xp.log(albedo))
        value, bent = fallen * (1 + y), fallen * y * y
        by_log_x = xp.where(beyond < 0, -3 * V_MAX / n, smooth_v) * (n / V_MAX) * x / (x + R_ZERO)
        by_q = value * (smooth_u * u_q - 4 * aq / 3 / albedo) - bent * kappa_q
        return value, value * by_log_x - bent, xp.sign(q) * by_q

    def _scatter(self, aq: Any) -> tuple[Any, Any, Any, Any]:
        """σs/σt′ and σt/σt′, each with its slope by q."""
        s, s_q = (1 - aq * aq / 3) / (1 - self.g), -2 * aq / 3 / (1 - self.g)
        return s, s_q, s + aq * aq / 3, s_q + 2 * aq / 3

    def _first(self, e: Engine, q: Any, x: Any) -> Look:
        """Light scattered once."""
        xp = e.xp
        aq = xp.maximum(xp.abs(q), SMALLEST_Q)
        s, s_q, t, t_q = self._scatter(aq)
        rho = t * x
        n = self.first.shape[-1]
        w = xp.log1p(rho / RHO_ZERO) * (n / W_MAX)
        cell, f = locate(xp, xp.minimum(w, n), n)
        level, level_w = cubic(powers_at(e, self.first, cell), f)
        value = s * xp.exp(level - self.first_decay * rho) / x
        slope = rho * (xp.where(w < n, level_w, 0.0) * (n / W_MAX) / (rho + RHO_ZERO) - self.first_decay)
        return value, value * (slope - 1), xp.sign(q) * value * (s_q / s + slope * (t_q / t))

    def radiance(self, e: Engine, q: Any, x: Any, mu: float, cos_2: Any, along: Any) -> Look:
        xp = e.xp
        aq = xp.maximum(xp.abs(q), SMALLEST_Q)
        u, u_q = _u(xp, aq)
        mean, across = _exit_bases(self.eta, mu)
        row, row_u = spline_rows(xp, self.angles, u[:, 0])
        n = row.shape[-1]
        v = xp.log1p(x / R_ZERO) * (n / V_MAX)
        cell, f = locate(xp, xp.minimum(v, n), n)
        v_x = xp.where(v < n, n / V_MAX * x / (x + R_ZERO), 0.0)
        parts = []
        for basis, k in ((mean, slice(0, mean.size)), (across, slice(mean.size, None))):
            here, here_u = ((basis[:, None, None] * each[:, k]).sum(1) for each in (row, row_u))
            value, by_v = cubic(e.take(here, cell), f)
            parts.append((value, by_v * v_x, cubic_value(e.take(here_u, cell), f) * u_q * xp.sign(q)))
        lobe, lobe_x, lobe_q = (a - cos_2 * b for a, b in zip(*parts, strict=True))
        m, m_x, m_q = self._multiple(e, q, x)
        once, once_x, once_q = self._first_radiance(e, q, x, mu)
        return (
            m * lobe + along * once,
            m_x * lobe + m * lobe_x + along * once_x,
            m_q * lobe + m * lobe_q + along * once_q,
        )

    def _first_radiance(self, e: Engine, q: Any, x: Any, mu: float) -> Look:
        """π L⁽¹⁾, the mean over all azimuths; see `single.first_order_bin_average` for the geometry."""
        if self.sin_beam > 0:
            return self._first_of_oblique(e, q, x, mu)
        xp = e.xp
        aq = xp.maximum(xp.abs(q), SMALLEST_Q)
        s, s_q, t, t_q = self._scatter(aq)
        sine = float(np.sqrt(1 - mu * mu))
        inside = float(np.sqrt(1 - (sine / self.eta) ** 2))
        safe = max(sine, float(np.finfo(float).tiny) ** 0.25)
        per_x = t * self.eta * (1 + inside) / safe
        phase = (1 - self.g**2) / (4 * np.pi) * (1 + self.g**2 + 2 * self.g * inside) ** -1.5
        out = phase * transmittance(np, self.eta, mu) / safe
        value = s * out * xp.exp(-per_x * x) / (2 * self.eta * x)
        return value, value * (-1 - per_x * x), xp.sign(q) * value * (s_q / s - per_x * x * t_q / t)

    def _first_of_oblique(self, e: Engine, q: Any, x: Any, mu: float) -> Look:
        """The same of an oblique beam, over the camera's azimuths about it too."""
        turns = np.cos((np.arange(N_TURNS) + 0.5) * np.pi / N_TURNS).tolist()
        parts = [self._first_towards(e, q, x, mu, turn) for turn in turns]
        value, by_x, by_q = (sum(each) / N_TURNS for each in zip(*parts, strict=True))
        return value, by_x, by_q

    def _first_towards(self, e: Engine, q: Any, x: Any, mu: float, turn: float) -> Look:
        """Of a camera at the azimuth ψ about the beam, turn = cos ψ: scattered after a path t, light leaves at t V,
        V² = s² + 2 s c τ cos ψ + c² τ², s and c of the beam inside and τ the tangent of the camera's angle."""
        xp = e.xp
        aq = xp.maximum(xp.abs(q), SMALLEST_Q)
        s, s_q, t, t_q = self._scatter(aq)
        sine, beam = float(np.sqrt(1 - mu * mu)) / self.eta, self.sin_beam
        inside, down = float(np.sqrt(1 - sine * sine)), float(np.sqrt(1 - beam * beam))
        tangent = down * sine / inside
        reach = max(float(np.sqrt(max(beam * beam + 2 * beam * tangent * turn + tangent * tangent, 0.0))), 1e-6)
        cos_theta = beam * sine * turn - down * inside
        phase = (1 - self.g**2) / (4 * np.pi) * (1 + self.g**2 - 2 * self.g * cos_theta) ** -1.5
        out = phase * transmittance(np, self.eta, mu) / (2 * self.eta**2 * inside * reach)
        per_x = t * (1 + down / inside) / reach
        value = s * out * xp.exp(-per_x * x) / x
        return value, value * (-1 - per_x * x), xp.sign(q) * value * (s_q / s - per_x * x * t_q / t)

    def first_by_side(self, e: Engine, q: Any, x: Any, mu: float) -> tuple[Any, Any]:
        """What light scattered once, a mean over places all around, owes to the camera's azimuth ψ about an oblique
        beam, of all that is seen: by cos ψ, and what both sides in the beam's plane have more than the mean over ψ."""
        if self.sin_beam == 0:
            return 0 * x, 0 * x
        xp = e.xp
        ahead, behind = (self._first_towards(e, q, x, mu, turn)[0] for turn in (1.0, -1.0))
        whole = self.radiance(e, q, x, mu, xp.zeros_like(x), xp.ones_like(x))[0]
        mean = self._first_of_oblique(e, q, x, mu)[0]
        return (ahead - behind) / 2 / whole, ((ahead + behind) / 2 - mean) / whole

    def total_radiance_factor(self, e: Engine, q: Any, mu: float) -> Any:
        u, _ = _u(e.xp, e.xp.maximum(e.xp.abs(q), SMALLEST_Q))
        mean, _ = _exit_bases(self.eta, mu)
        return sum(float(b) * spline(e, self.total_angles[k][None], u)[0] for k, b in enumerate(mean))

    def shape_sd(self, e: Engine, q: Any, x: Any) -> Any:
        """Of the light scattered twice or more; by all light."""
        xp = e.xp
        aq = xp.minimum(xp.maximum(xp.abs(q), SMALLEST_Q), self.q_max)
        table = xp.asarray(self.log_curve_sd)
        rows, n = table.shape
        row, above = locate(xp, xp.minimum(_u(xp, aq)[0] * (rows - 1), rows - 1), rows - 1)
        sd = table[row[:, 0]] + above * (table[row[:, 0] + 1] - table[row[:, 0]])
        at, f = locate(xp, xp.minimum(xp.log1p(x / R_ZERO) * ((n - 1) / V_MAX), n - 1), n - 1)
        (left,), (right,) = e.take(sd[:, None, :-1], at), e.take(sd[:, None, 1:], at)
        return left + f * (right - left)


N_TURNS = 24
"""Azimuths of a camera about an oblique beam, over half a turn."""
KNOT_STEP = float(V_MAX) / 46
"""Between neighbouring knots of the table's curve in ln(x + R_ZERO): their Monte Carlo errors are independent."""


def dipole(eta: float) -> Dipole:
    """The dipole of an interface of index `eta`."""
    return Dipole(float(eta), boundary_a(float(eta)))


def transmittance(xp: Any, eta: Any, mu: Any) -> Any:
    """Ft at the outside cosine `mu`; 0 where an `eta` below 1 reflects all."""
    refracted2 = (eta - 1) * (eta + 1) + mu * mu
    inside = xp.sqrt(xp.maximum(refracted2, 0.0))
    r_s, r_p = (mu - inside) / (mu + inside), (eta * eta * mu - inside) / (eta * eta * mu + inside)
    return xp.where(refracted2 > 0, 1 - (r_s * r_s + r_p * r_p) / 2, 0.0)


@lru_cache(maxsize=256)
def exit_norm(eta: float) -> float:
    """C = 2∫₀¹ Ft(eta, μ) μ dμ over outside directions; see `fresnel.exit_norm`."""
    denser = max(eta, 1 / eta)
    met = float((3 * _WEIGHTS * _U**5 * transmittance(np, denser, _U**3)).sum())
    return met if eta >= 1 else met / denser**2


def boundary_a(eta: float) -> float:
    """A by the paper's polynomial for 1 < eta ≤ 2, and by quadrature elsewhere; see `fresnel.boundary_a`."""
    fdr = -1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta
    if not 1 < eta <= 2:
        fdr = 1 - exit_norm(1 / eta)
    return (1 + fdr) / (1 - fdr)


def coefficients(log_sigma_tp: Any, q: Any) -> tuple[Any, Any]:
    """(σa, σs′) [1/mm]; σa is 0 where q is below 0."""
    absorbed = np.maximum(q, 0.0) ** 2 / 3
    return np.exp(log_sigma_tp) * absorbed, np.exp(log_sigma_tp) * (1 - absorbed)


def shape_of(sigma_a: Any, sigma_sp: Any) -> tuple[Any, Any]:
    """(ln σt′, q) of the coefficients [1/mm]."""
    sigma_tp = sigma_a + sigma_sp
    return np.log(sigma_tp), np.sqrt(3 * sigma_a / sigma_tp)


def _added(a: Look, b: Look) -> Look:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _u(xp: Any, aq: Any) -> tuple[Any, Any]:
    """u/U_MAX, along which light varies evenly with q, and its slope by q."""
    big = xp.sqrt(aq * aq / 3 + _EPS)
    albedo = 1 - aq * aq / 3
    u = (xp.log1p(big / Q_ZERO) - xp.log(albedo) / 2) / U_MAX
    return u, (aq / 3 / big / (big + Q_ZERO) + aq / 3 / albedo) / U_MAX


def _exit_bases(eta: float, mu: float) -> tuple[Any, Any]:
    """Ft times Legendre polynomials of the cosine inside: for the mean over azimuths, and for what an azimuth adds."""
    inside = np.sqrt(1 - (1 - mu * mu) / eta**2)
    grazing = np.sqrt(1 - 1 / eta**2)
    centred = (2 * inside - 1 - grazing) / (1 - grazing)
    polynomials = np.polynomial.legendre.legvander(np.asarray(centred), 4).ravel()
    through = float(transmittance(np, eta, mu))
    return through * polynomials, through * (1 - mu * mu) / eta**2 * polynomials[:3]


def table_of(model: Any) -> WhiteTable:
    """The arrays of a white table, by name, as this module's Table."""
    names = [n for n in WhiteTable._fields if n not in WhiteTable._field_defaults]
    arrays: dict[str, Any] = {name: np.asarray(getattr(model, name)) for name in names}
    return WhiteTable(**arrays)._replace(eta=float(model.eta), g=float(model.g))
