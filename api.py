"""What `import bssrdf` offers: each stage by one call, on paths or on what is in memory already.

A keyword is checked as the option of the same name is, and a wrong one raises InputError. Nothing is written but by
`measure_session` and `save`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from hashlib import sha256
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

import bssrdf
from bssrdf.errors import InputError
from bssrdf.fit import FitOptions, fit_g, fit_slices
from bssrdf.session import HEADER, about, slice_from_arrays, slice_from_dataframe, slice_of, write_fit
from bssrdf.session import read_fit as _read_fit
from bssrdf.session import read_session as _read_session
from bssrdf.session import read_slice as _read_slice
from bssrdf.session.checks import known_keys, shown
from bssrdf.session.records import Array, Fit, Session, Slice
from bssrdf.transport import Making, forward_curve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bssrdf.measure import Measured

Place = str | PathLike[str]
IN_MEMORY = "(in memory)"


class ApiSlice(Slice):
    """A slice: `read_slice` reads one, `from_arrays` and `from_dataframe` make one."""

    @staticmethod
    def from_arrays(r_mm: ArrayLike, rd: Any, sd: Any = None, **keys: Any) -> Slice:
        """A slice of radii [mm] and R_d [1/mm²] of shape (n,), or of curves by channel: `rd={"R": …, "G": …}`.

        `eta`, `flux` ("entering" or "incident") and `exit` ("hemisphere", "lambertian" or "fresnel") must be given;
        further keys, such as `g` and `total_r`, are those of slice.csv.
        """
        return slice_from_arrays(r_mm, rd, sd, **keys)

    @staticmethod
    def from_dataframe(frame: Any, **keys: Any) -> Slice:
        """A slice of a frame with the columns r_mm, rd_per_mm2 and, if known, channel and sd_per_mm2."""
        return slice_from_dataframe(frame, **keys)


@dataclass(frozen=True)
class ApiFit(Fit):
    """A fit with the curve it rests on. `channels` holds the coefficients and their errors by channel."""

    curve: Slice | None = field(default=None, repr=False, compare=False)

    def table(self, format: Literal["md", "csv", "json", "latex"] = "md") -> str:  # noqa: A002  # as the option is called
        """One row per channel, as text."""
        from bssrdf.report import fits_table

        return fits_table([self], format)

    def plot(self) -> Figure:
        """R_d(r) of every channel with model, dipole and residuals, as a figure of matplotlib."""
        from bssrdf.report import draw_fit

        return draw_fit(self, self._curve())

    def save(self, path: Place) -> Path:
        """Write fit.json."""
        write_fit(Path(path), self)
        return Path(path)

    def report(self, path: Place) -> Path:
        """Write the page of `bssrdf report`; what asks for frames says that there are none."""
        from bssrdf.report import write_page

        return write_page(Path(path), self, self._curve(), self.input_path)

    def _curve(self) -> Slice:
        if self.curve is None:
            raise InputError(f"{self.input_path}: this fit was read without its curve; fit the slice again")
        return self.curve

    def _repr_html_(self) -> str:
        from bssrdf.report import fit_html

        return fit_html(self, self.curve)


def measure_session(session: Place | Session, **options: Any) -> Measured:
    """Measure a session's folder and write its measured/, as `bssrdf measure` does, with the options of that name."""
    from bssrdf.measure import measure_session as measure  # imports OpenCV, which a fit does not need

    whole = not options.get("hdr_only", False)
    known = ("hdr_only", "from_hdr", "radial", "glare", "band_mm", "hdr_rel_sd", "space", "progress")
    known_keys(Path("measure_session"), "", options, known)
    for name in ("band_mm", "hdr_rel_sd"):
        value = options.get(name)
        if value is not None and not (isinstance(value, int | float) and 0 < value < float("inf")):
            raise InputError(f"measure_session: {name} = {shown(value)} must be a finite number > 0")
    return measure(session if isinstance(session, Session) else _read_session(Path(session), complete=whole), **options)


def fit_slice(piece: Place | Slice, *, making: Making | None = None, **keywords: Any) -> ApiFit:
    """σa and σs′ of every channel of a slice, of a slice.csv, or of a measured session's folder.

    Keywords are the options of `bssrdf fit`: `model`, `constraint`, `scale`, `window_mm`, `robust`, `tables`, `fit_g`,
    and keys of slice.csv such as `eta`, which win. InputError for a wrong keyword or value, and where a file cannot be
    used; a fit that fails says so in its `status`.
    """
    where = Path("fit_slice")
    own = {option.name for option in fields(FitOptions)}
    known_keys(where, "", keywords, [*own, "fit_g", *HEADER])
    options = _options({name: value for name, value in keywords.items() if name in own})
    keys = {name: value for name, value in keywords.items() if name in HEADER and value is not None}
    path, curve = _curve_of(where, piece, keys)
    flags: tuple[str, ...] = ()
    if keywords.get("fit_g"):
        curve, flags = replace(curve, g=fit_g(curve, FitOptions()).g), ("g_fitted",)
    (channels,) = fit_slices([curve], options, making=making or Making())
    channels = {name: replace(each, flags=(*each.flags, *flags)) for name, each in channels.items()}
    asked = {name: getattr(options, name) for name in sorted(own) if getattr(options, name) is not None}
    digest = sha256(path.read_bytes() if path else repr(curve).encode()).hexdigest()
    return ApiFit(
        bssrdf.__version__, str(path or IN_MEMORY), digest, asked | keys, curve.material, curve.eta, curve.g,
        channels, about(curve), curve=curve,
    )  # fmt: skip


def read_slice(path: Place, **keys: Any) -> Slice:
    """The curve in a slice.csv; `keys` win over those in the file."""
    known_keys(Path(path), "", keys, HEADER)
    return _read_slice(Path(path), **keys)


def read_session(path: Place) -> Session:
    """What session.toml in the folder says."""
    return _read_session(Path(path))


def read_fit(path: Place) -> ApiFit:
    """The fit in a fit.json."""
    return ApiFit(**vars(_read_fit(Path(path))))


def rd(
    r_mm: ArrayLike, *, sigma_a_per_mm: float, sigma_sp_per_mm: float, eta: float, g: float = 0.0, model: str = "mc"
) -> Array:
    """R_d [1/mm²] at radii of shape (n,) of a half space with these coefficients, by `mc` or `dipole`.

    Per unit flux that entered, over all directions of exit.
    """
    return forward_curve(
        r_mm, sigma_a_per_mm=sigma_a_per_mm, sigma_sp_per_mm=sigma_sp_per_mm, eta=eta, g=g, model=model
    ).rd_per_mm2


def _curve_of(where: Path, piece: Place | Slice, keys: dict[str, Any]) -> tuple[Path | None, Slice]:
    """The slice with the keys that win, and its file if it has one."""
    if isinstance(piece, Slice):
        header = {name: getattr(piece, name) for name in HEADER if hasattr(piece, name)}
        given = {name: value for name, value in (header | keys).items() if value not in (None, {}, ())}
        return None, slice_of(where, piece.channels, given)
    if not isinstance(piece, str | PathLike):
        raise InputError(f"{where}: {shown(piece)} is neither a slice nor a path; make one by Slice.from_arrays")
    path = Path(piece) / "measured" / "slice.csv" if Path(piece).is_dir() else Path(piece)
    return path, _read_slice(path, **keys)


def _options(given: dict[str, Any]) -> FitOptions:
    """The options, each held to the type that it declares."""
    hints = get_type_hints(FitOptions)
    for name, value in given.items():
        choices = _choices(hints[name])
        if value is not None and choices and value not in choices:
            raise InputError(f"fit_slice: {name} = {shown(value)} must be one of {', '.join(choices)}")
    window = given.get("window_mm")
    if window is not None:
        ends = np.asarray(window, float) if np.shape(window) == (2,) else np.array([1.0, 0.0])
        if not 0 <= ends[0] < ends[1]:
            raise InputError(f"fit_slice: window_mm = {shown(window)} must be two radii, the smaller one first")
        given = given | {"window_mm": (float(ends[0]), float(ends[1]))}
    if not isinstance(given.get("robust", False), bool):
        raise InputError(f"fit_slice: robust = {shown(given['robust'])} must be True or False")
    return FitOptions(**given)


def _choices(hint: Any) -> tuple[str, ...]:
    """The words of a Literal, also where None is allowed beside."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    return next((get_args(each) for each in get_args(hint) if get_origin(each) is Literal), ())
