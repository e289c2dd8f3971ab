"""Tables over a grid of (η, g): the file that holds them, and interpolation between them."""

from __future__ import annotations

import hashlib
import os
import zipfile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bssrdf.errors import InputError
from bssrdf.transport.incidence import NORMAL, Incidence
from bssrdf.transport.white.assembly import assemble
from bssrdf.transport.white.model import TableModel

if TYPE_CHECKING:
    from bssrdf.transport.white.smooth import FittedTable

Floats = NDArray[np.float64]
Places = NDArray[np.int_]

FORMAT = 2
KIND = "bssrdf white table"
NEIGHBOURS = 4
"""Nodes of η and of g that take part in an interpolation, at most."""


class TableSet(NamedTuple):
    """Tables at every pair of `etas` and `gs`; see `table_fit.FittedTable` for the arrays."""

    etas: Floats
    gs: Floats
    log_curve: Floats
    """(n_g, n_eta, …)."""
    log_curve_sd: Floats
    angles: Floats

    def covers(self, eta: float, g: float) -> bool:
        """Whether (eta, g) lies on or between the nodes."""
        return bool(self.etas[0] <= eta <= self.etas[-1] and self.gs[0] <= g <= self.gs[-1])

    @threadpool_limits.wrap(limits=1, user_api="blas")
    def model(self, eta: float, g: float, beam: Incidence = NORMAL) -> TableModel:
        """The model at (eta, g), by cubic interpolation of ln R; at a node it is that table itself."""
        if not self.covers(eta, g):
            raise InputError(
                f"eta = {eta}, g = {g}: the tables cover eta {self.etas[0]:g} to {self.etas[-1]:g} "
                f"and g {self.gs[0]:g} to {self.gs[-1]:g}"
            )
        one, weights = self.of(g), lagrange(self.etas, eta, _about(self.etas, eta))
        log_curve, sd, angles = _mixed(weights, *(each[0] for each in one[2:]))
        return assemble(eta, g, log_curve, sd, angles, beam)

    def of(self, g: float) -> TableSet:
        """The tables of this g at every node of η."""
        mixed = _mixed(lagrange(self.gs, g), *self[2:])
        return TableSet(self.etas, np.array([g]), *(each[None] for each in mixed))

    def widened(self, coarse: TableSet, factor: float) -> TableSet:
        """With coarse tables of the same g beyond its own nodes of η, whose error is `factor` times what they say."""
        coarse = coarse._replace(log_curve_sd=factor * coarse.log_curve_sd)
        beyond = (coarse.etas < self.etas[0]) | (coarse.etas > self.etas[-1])
        etas = np.append(self.etas, coarse.etas[beyond])
        order = np.argsort(etas)
        arrays = (
            np.concatenate([a, b[:, beyond]], axis=1)[:, order] for a, b in zip(self[2:], coarse[2:], strict=True)
        )
        return TableSet(etas[order], self.gs, *arrays)


def _mixed(weights: Floats, log_curve: Floats, log_curve_sd: Floats, angles: Floats) -> tuple[Floats, Floats, Floats]:
    """Along the first axis."""
    sd = np.tensordot(np.abs(weights), log_curve_sd, 1)
    return np.tensordot(weights, log_curve, 1), sd, np.tensordot(weights, angles, 1)


def _nearest(nodes: Floats, x: float) -> Places:
    """Places of the NEIGHBOURS nearest."""
    return np.sort(np.argsort(np.abs(nodes - x), kind="stable")[:NEIGHBOURS])


def _about(nodes: Floats, x: float) -> Places:
    """Of half of them on each side: where nodes lie dense on one, the nearest would all be there."""
    first = int(np.clip(np.searchsorted(nodes, x) - NEIGHBOURS // 2, 0, max(nodes.size - NEIGHBOURS, 0)))
    return np.arange(first, min(first + NEIGHBOURS, nodes.size))


def lagrange(nodes: Floats, x: float, near: Places | None = None) -> Floats:
    """Weights of the values at `nodes` in their interpolating polynomial at x, by the nearest or by those `near`."""
    near = _nearest(nodes, x) if near is None else near
    weights = np.zeros(nodes.size)
    for i in near:
        others = nodes[near[near != i]]
        weights[i] = np.prod((x - others) / (nodes[i] - others))
    return weights


def table_set(tables: dict[tuple[float, float], FittedTable]) -> TableSet:
    """The set of tables given by (g, eta), a full grid."""
    gs = sorted({g for g, _ in tables})
    etas = sorted({eta for _, eta in tables})

    def grid(field: str) -> Floats:
        return np.array([[getattr(tables[g, eta], field) for eta in etas] for g in gs])

    return TableSet(np.array(etas), np.array(gs), grid("log_curve"), grid("log_curve_sd"), grid("angles"))


def kind_of(beam: Incidence) -> str:
    """What a file says it holds."""
    if beam.angle_deg == 0:
        return KIND
    return f"{KIND} at {beam.angle_deg!r} degrees" + (" across" if beam.across else "")


def write_tables(path: Path, tables: TableSet, beam: Incidence = NORMAL, *, small: bool = False) -> None:
    """Write the tables in single precision; the file appears under its name only when it is whole.

    `small` keeps errors and angles in half precision, which is 5e-4 of them.
    """
    arrays: dict[str, Any] = {name: array.astype(np.float32) for name, array in tables._asdict().items()}
    if small:
        arrays |= {name: arrays[name].astype(np.float16) for name in ("log_curve_sd", "angles")}
    arrays["etas"], arrays["gs"] = tables.etas, tables.gs
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            np.savez_compressed(file, format=FORMAT, kind=kind_of(beam), checksum=_checksum(arrays), **arrays)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def read_tables(path: Path, beam: Incidence = NORMAL) -> TableSet:
    """Read what `write_tables` wrote for this beam; raises InputError for anything else."""
    try:
        with path.open("rb") as file:
            arrays = _arrays(file, kind_of(beam))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        raise InputError(
            f"{path}: not a table of Monte Carlo light ({error}); delete it and it is made again"
        ) from None
    return TableSet(**{name: array.astype(np.float64) for name, array in arrays.items()})


def _arrays(file: IO[bytes], kind: str) -> dict[str, NDArray[np.generic]]:
    with np.load(file, allow_pickle=False) as stored:
        if str(stored["kind"]) != kind:
            raise ValueError(f'kind "{stored["kind"]}"')
        if int(stored["format"]) != FORMAT:
            raise ValueError(f"format {stored['format']} instead of {FORMAT}")
        arrays = {name: stored[name] for name in TableSet._fields}
        if str(stored["checksum"]) != _checksum(arrays):
            raise ValueError("its checksum is wrong")
    return arrays


def _checksum(arrays: dict[str, NDArray[np.generic]]) -> str:
    digest = hashlib.sha256()
    for name in TableSet._fields:
        digest.update(f"{name} {arrays[name].shape} {arrays[name].dtype.str}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
