"""slices.parquet to fits.parquet: groups of slices through the batched fit, read, fitted and written one by one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from bssrdf.batch.fit_steps import asked, fit_all, fit_of
from bssrdf.batch.fits_parquet import NamedFit, write_fits
from bssrdf.batch.slices_parquet import Named, count_curves, read_slices
from bssrdf.errors import BssrdfError, InputError
from bssrdf.fit import FitOptions
from bssrdf.session import doubt
from bssrdf.session.records import Slice
from bssrdf.transport import SILENT, Making

CURVES = 6144
"""That are fitted together: 24 batches of the fit, so that few rows are left over where kinds are mixed."""
VALUES = 4_000_000
"""Radii that are held together at most: 200 MB with all that the fit lays out of them."""


class BulkCounts(NamedTuple):
    """What became of the curves of a file."""

    statuses: Counter[str]
    failures: list[tuple[str, int, str]]
    """Name, exit code and line of each slice that could not be fitted."""
    doubts: list[str]
    """One for each whose units look wrong."""


def fit_parquet(
    source: Path,
    out: Path,
    options: FitOptions,
    keys: Mapping[str, Any],
    *,
    rows: tuple[int, int] | None = None,
    making: Making = SILENT,
    progress: Callable[[str, int, int], None] | None = None,
) -> BulkCounts:
    """Fit all slices of a Parquet file, or of a folder of them, and write the fits to `out`, a row per channel.

    `keys` are keys of slice.csv that win over the columns; `rows` are those of a file that are fitted, all if None. A
    slice that fails is a row with its error; raises InputError where the file itself cannot be read or written.
    """
    counts = BulkCounts(Counter(), [], [])
    total, done = count_curves(source), 0
    if not total:
        raise InputError(f"{source}: holds no slice; give a Parquet file that does")
    with write_fits(out) as write:
        for group in _groups(read_slices(source, keys, lean=True, rows=rows)):
            if progress is not None:
                progress("curves", done, total)
            fits = fit_named(group, str(source), options, keys, making)
            write(fits)
            done += sum(len(each.slice.channels) for each in group if isinstance(each.slice, Slice))
            _count(counts, group, fits, source, options)
    return counts


def fit_named(
    group: list[Named], source: str, options: FitOptions, keys: Mapping[str, Any], making: Making = SILENT
) -> list[NamedFit]:
    """The fits of slices that were read from `source`; an error in the place of one that fails."""
    good = [(f"{source}: slice {each.name}", each.slice) for each in group if isinstance(each.slice, Slice)]
    fitted = iter(fit_all(good, options, making))
    given = asked(options, keys)
    fits = []
    for name, sha256, piece in group:
        found: Any = piece if isinstance(piece, BssrdfError) else next(fitted)
        if isinstance(piece, Slice) and not isinstance(found, BssrdfError):
            found = fit_of(name, sha256, piece, found, given)
        fits.append(NamedFit(name, found))
    return fits


def _groups(read: Iterator[list[Named]]) -> Iterator[list[Named]]:
    """What was read, put together to the size that is fitted at once."""
    group: list[Named] = []
    curves = values = 0
    for several in read:
        for each in several:
            group.append(each)
            channels = each.slice.channels.values() if isinstance(each.slice, Slice) else ()
            curves, values = curves + len(channels), values + sum(part.r_mm.size for part in channels)
            if curves >= CURVES or values >= VALUES:
                yield group
                group, curves, values = [], 0, 0
    if group:
        yield group


def _count(counts: BulkCounts, group: list[Named], fits: list[NamedFit], source: Path, options: FitOptions) -> None:
    for each, found in zip(group, fits, strict=True):
        if isinstance(found.fit, BssrdfError):
            counts.failures.append((each.name, found.fit.exit_code, str(found.fit)))
            continue
        counts.statuses.update(channel.status for channel in found.fit.channels.values())
        assert isinstance(each.slice, Slice)
        if options.scale == "given" and (said := doubt(each.slice)) is not None:
            counts.doubts.append(f"{source}: slice {each.name}: {said}")
