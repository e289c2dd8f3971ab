"""Slices in bulk: what a Parquet file of them costs over the fits alone, and what as many slice.csv files do."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bssrdf.batch import Named, fit_files, fit_parquet, read_slices, write_slices
from bssrdf.bench.fit import noisy_curves
from bssrdf.errors import BssrdfError
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.session import fit_line, write_slice
from bssrdf.session.records import ChannelSlice, Slice

CHANNELS = "RGB"
_GROUP = 1024


@dataclass(frozen=True)
class BulkScore:
    """A Parquet file of slices, fitted into another."""

    curves: int
    seconds: float
    """Processor time of reading, fitting and writing."""
    fits_seconds: float
    """Of the fits of the same slices alone."""
    peak_mb: float
    """Of the process so far."""

    @property
    def ratio(self) -> float:
        return self.seconds / self.fits_seconds


@dataclass(frozen=True)
class FilesScore:
    """As many slice.csv files, fitted to a line of JSON each."""

    files: int
    seconds: float
    """Processor time, as of `BulkScore`."""
    fits_seconds: float

    @property
    def ms_over_fits(self) -> float:
        """Of each file."""
        return 1e3 * (self.seconds - self.fits_seconds) / self.files


def noisy_slices(count: int) -> Iterator[Slice]:
    """Slices of three channels of `bench fit`'s curves."""
    curves, _, _ = noisy_curves(3 * min(count, _GROUP))
    for at in range(count):
        rows = [(3 * at + k) % (3 * min(count, _GROUP)) for k in range(3)]
        parts = {
            name: ChannelSlice(curves.r_mm[row], curves.rd[row], np.asarray(curves.sd[row]))
            for name, row in zip(CHANNELS, rows, strict=True)
        }
        totals, sds = (
            {name: float(each[row]) for name, row in zip(CHANNELS, rows, strict=True)}
            for each in (curves.total_r, curves.total_r_sd)
        )
        yield Slice(parts, curves.eta, "entering", "hemisphere", total_r=totals, total_r_sd=sds, g=0.0)


def bulk_score(folder: Path, count: int) -> BulkScore:
    """Write a file of so many slices, and fit it."""
    source, target = folder / "slices.parquet", folder / "fits.parquet"
    with write_slices(source) as write:
        group: list[Named] = []
        for at, piece in enumerate(noisy_slices(count)):
            group.append(Named(f"slice {at}", "", piece))
            if len(group) == _GROUP:
                write(group)
                group = []
        write(group)
    fits_seconds = 0.0
    fit_slices([*noisy_slices(1)])  # the tables are there before the clock runs
    began = time.process_time()
    fit_parquet(source, target, FitOptions(), {})
    seconds = time.process_time() - began
    for several in read_slices(source, lean=True):
        pieces = [each.slice for each in several if isinstance(each.slice, Slice)]
        began = time.process_time()
        fit_slices(pieces)
        fits_seconds += time.process_time() - began
    return BulkScore(len(CHANNELS) * count, seconds, fits_seconds, _peak_mb())


def files_score(folder: Path, count: int) -> FilesScore:
    """Write so many slice.csv files, and fit them."""
    folder.mkdir()
    files = [folder / f"{at:06}.csv" for at in range(count)]
    pieces = [*noisy_slices(count)]
    for file, piece in zip(files, pieces, strict=True):
        write_slice(file, piece)
    fit_slices(pieces[:1])
    began = time.process_time()
    for fit in fit_files(files, FitOptions(), {}):
        assert not isinstance(fit, BssrdfError)
        fit_line(fit)
    middle = time.process_time()
    fit_slices(pieces)
    return FilesScore(count, middle - began, time.process_time() - middle)


def _peak_mb() -> float:
    """The most memory that this process has held; NaN where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return math.nan
    return next(float(line.split()[1]) / 1000 for line in lines if line.startswith("VmHWM"))
