"""What a fit is of: its data, the plan that is fixed within a batch, its parameters, and what is worked out at a point.

Shapes: b problems, u radii of a slice, P parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from bssrdf.fit.layout import Curves, Total
from bssrdf.transport.light import Light
from bssrdf.transport.observed import QuadratureNodes, Seen, Sight

Constraint = Literal["exact", "soft", "none"]
Source = Literal["scale", "length", "spot", "view", "exit", "side", "table", "eta", "g", "thickness", "back", "ratio"]
AT_0 = 1e-6
"""Of q: σa is then below 1e-12 of σs′."""
OF_MEDIUM: tuple[Source, ...] = ("eta", "g")
OF_CURVE: tuple[Source, ...] = ("length", *OF_MEDIUM)
"""Errors whose responses ask for the curve itself."""


class Shared(NamedTuple):
    """One error that several data share, as a column of the normal equations."""

    source: Source
    slices: tuple[int, ...]
    """Those that it touches, by their place in the problem."""
    mode: int = 0


class Plan(NamedTuple):
    """What is fixed within a batch, and compiled for."""

    totals: tuple[int, ...]
    """The slice that each R belongs to; none where R does not count."""
    exact: bool
    """Whether R is a condition, which fixes q, and not a datum."""
    scale_free: bool
    robust: bool
    sights: tuple[Sight, ...]
    """One a slice."""
    shared: tuple[Shared, ...]

    @property
    def free(self) -> tuple[int, ...]:
        """Columns that move beside shared errors: s, q unless R fixes it, c where the scale is unknown."""
        return (0, *(() if self.exact else (1,)), *((2,) if self.scale_free else ()))

    @property
    def weighed(self) -> int:
        """How many R are data."""
        return 0 if self.exact else len(self.totals)

    def bent(self, q: Any, q_sd: Any, parabolic: float) -> Any:
        """(b,): whether linear errors of q (b,) do not describe σa: at 0, or within `parabolic` sd where R is not a
        condition that fixes q."""
        return (q < AT_0) & ~(q_sd > 0) if self.exact else ~(q > parabolic * q_sd)

    @property
    def curve_alone(self) -> Plan:
        """The same without R, where R is a condition."""
        return self._replace(totals=(), exact=False) if self.exact else self


class Sds(NamedTuple):
    """Standard deviations that a slice states, (b, 1) each: scale, length and spot relative, view in rad."""

    scale: Any
    length: Any
    spot: Any
    view: Any
    eta: Any
    g: Any
    thickness: Any
    """Relative."""
    back: Any
    """Of its reflectance."""


class Problem(NamedTuple):
    """The data of a batch: by slice, and by total."""

    curves: tuple[Curves, ...]
    totals: tuple[Total, ...]
    sds: tuple[Sds, ...]
    factor_slopes: tuple[tuple[float, float], ...]
    """By slice, d ln of the slice's convention by view angle [1/rad] and by η."""
    samples: tuple[Any, ...]
    """By slice a `Sample`, empty for a half space."""


class Point(NamedTuple):
    """Parameters, (b, 1) each."""

    log_sigma: Any
    q: Any
    log_scale: Any


class Laid(NamedTuple):
    """What costs more than a look and moves little: worked out at a point, used near it. By slice."""

    nodes: tuple[QuadratureNodes, ...]
    seen: tuple[Seen, ...]
    responses: tuple[Any, ...]
    """(b, K, u): of ln of the curve to one sd of each shared error."""
    total_seen: tuple[Any, ...]
    total_responses: tuple[Any, ...]
    """By total, (b, K): of ln R."""
    samples: tuple[Any, ...]
    """By slice a `SampleRatio`, empty for a half space."""


class Looked(NamedTuple):
    """What the model has at a point."""

    curves: tuple[tuple[Any, Any, Any], ...]
    """By slice, (b, u) each: what is seen [1/mm²] and its slopes by ln σt′ and q."""
    totals: tuple[tuple[Any, Any, Any], ...]
    """By total: R and its slopes by ln σt′ and q, the latter taken beside q = 0."""
    half: Any
    """R of a half space."""


class Gaps(NamedTuple):
    """By total."""

    gaps: tuple[Any, ...]
    """(b, 1): R measured less that of the model."""
    rows: tuple[Any, ...]
    """(b, P): slopes of the model's by every parameter."""
    sds: tuple[Any, ...]
    """(b, 1): of R measured, and of what back and wall make of it."""


class Weights(NamedTuple):
    """Weights in force. By slice: (b, u) Σ w² over the data of a radius, and their weighted mean."""

    mass: tuple[Any, ...]
    mean: tuple[Any, ...]


class System(NamedTuple):
    """Normal equations in all parameters (s, q, c, then shared errors), with priors; and the totals' rows."""

    cost: Any
    gradient: Any
    """(b, P): Xᵀ W (data − model)."""
    matrix: Any
    """(b, P, P)."""


Neighbours = dict[str, tuple[Callable[[], Light], float]]
"""By `eta` and `g`: a model a little aside, made when it is first asked for, and how far."""


def held_any(plan: Plan) -> bool:
    """Whether a slice is of a finite sample."""
    return any(s.held != "half" for s in plan.sights)
