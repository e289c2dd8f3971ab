"""`bssrdf bench fit`: time against error for models and constraints, beside jaxopt and SciPy on the same curves.

The curves are the Monte Carlo table's light of the published materials of η = 1.3, 1 to 24 mean free paths in 200 radii
with 1 % noise, and R to 0.2 %. So the table's errors are statistical, and the dipole's show what the model costs. Of
those plain curves the search and its errors are timed; of curves as a camera has them, all that `bssrdf fit` reports.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from bssrdf.bench.camera_curves import CameraFit, fit_camera
from bssrdf.bench.fit_peers import PeerFit, PeerProblem, jaxopt_soft, scipy_exact, scipy_slsqp, scipy_soft, timed
from bssrdf.bench.trials import ModelName
from bssrdf.fit import Constraint, FitOptions, Job, fit_group
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport import CHANNELS, absorption_ratio, load_materials, scoped_x64, shipped_table, table_model
from bssrdf.transport.dipole import Medium
from bssrdf.transport.light import coefficients, dipole

ETA = 1.3
N_RADII = 200
BATCH = 1024
CAMERA_COPIES = 10
"""Of 36 curves."""
SLOW = 60
"""Curves that a method gets which fits them one by one."""
OURS: tuple[tuple[Literal["dipole", "mc"], Constraint], ...] = (
    ("dipole", "exact"),
    ("dipole", "soft"),
    ("dipole", "none"),
    ("mc", "exact"),
    ("mc", "soft"),
    ("mc", "none"),
)


@dataclass(frozen=True)
class FitScore:
    """One method: its speed and its median and 90th percentile relative errors."""

    method: str
    fits_per_second: float
    """Of the processor."""
    sigma_sp_median: float
    sigma_sp_p90: float
    sigma_a_median: float
    sigma_a_p90: float
    fails: int
    """Curves on which the method gave up; its errors are those of the others."""
    from_optimum: float | None = None
    """Largest relative distance of ln σt′ from SciPy's optimum of the same problem."""


@scoped_x64
def run_fit_bench(
    *,
    out: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    batch: int = BATCH,
    copies: int = CAMERA_COPIES,
) -> list[FitScore]:
    """Run every method; with `out` also write fit.json and fit.png there."""
    problem, sigma_a, sigma_sp = noisy_curves(batch)
    few = _first(problem, SLOW)
    ratio = np.asarray(absorption_ratio(jnp.asarray(few.total_r), ETA))

    def camera(model: ModelName) -> CameraFit:
        return fit_camera(model, copies)

    steps: dict[str, Callable[[], PeerFit | CameraFit]] = {
        **{f"{model} {constraint}": partial(_ours, model, constraint, problem) for model, constraint in OURS},
        "mc camera": partial(camera, "mc"),
        "auto camera": partial(camera, "auto"),
        "jaxopt soft": lambda: jaxopt_soft(problem),
        "scipy least_squares exact": lambda: scipy_exact(few, ratio),
        "scipy least_squares soft": lambda: scipy_soft(few),
        "scipy SLSQP": lambda: scipy_slsqp(few),
    }
    answers: dict[str, CameraFit] = {}
    for number, (name, run) in enumerate(steps.items()):
        if progress is not None:
            progress(name, number, len(steps))
        answer = run()
        answers[name] = answer if isinstance(answer, CameraFit) else CameraFit(answer, sigma_a, sigma_sp)
    optima = {"dipole exact": "scipy least_squares exact", "dipole soft": "scipy least_squares soft"}
    scores = [_score(name, answer, answers.get(optima.get(name, ""))) for name, answer in answers.items()]
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "fit.json").write_text(json.dumps([asdict(score) for score in scores], indent=1) + "\n")
        _draw(out / "fit.png", [score for score in scores if "camera" not in score.method])
    return scores


def ratios(scores: list[FitScore]) -> dict[str, float]:
    """Speed of each method over that of SciPy one by one, in the same run."""
    base = next(score.fits_per_second for score in scores if score.method == "scipy least_squares exact")
    return {score.method: score.fits_per_second / base for score in scores}


def table(scores: list[FitScore]) -> str:
    """The scores as Markdown; speeds also as ratios to SciPy one by one."""
    to_scipy = ratios(scores)
    lines = [
        "| method | fits/CPU s | × SciPy | σs′ error median / p90 | σa error median / p90 | fails "
        "| from SciPy's optimum |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {s.method} | {s.fits_per_second:.0f} | {to_scipy[s.method]:.1f} "
        f"| {100 * s.sigma_sp_median:.2f} / {100 * s.sigma_sp_p90:.1f} % "
        f"| {100 * s.sigma_a_median:.2f} / {100 * s.sigma_a_p90:.1f} % "
        f"| {s.fails or ''} "
        f"| {'' if s.from_optimum is None else f'{s.from_optimum:.1e}'} |"
        for s in scores
    ]
    return "\n".join(lines)


@scoped_x64
def noisy_curves(batch: int) -> tuple[PeerProblem, np.ndarray, np.ndarray]:
    """Curves with noise, and the coefficients that they were made from."""
    cells = [
        material.medium(channel)
        for material in load_materials().values()
        for channel in CHANNELS
        if material.eta == ETA and material.name != "Spectralon"
    ]
    rng = np.random.default_rng(0)
    which = np.arange(batch) % len(cells)
    sigma_a = np.array([cells[i].sigma_a for i in which], float)
    sigma_sp = np.array([cells[i].sigma_sp for i in which], float)
    light = table_model(ETA, 0.0)
    r_mm = np.linspace(1, 24, N_RADII) / (sigma_a + sigma_sp)[:, None]
    medium = Medium(jnp.asarray(sigma_a), jnp.asarray(sigma_sp), ETA)
    rd = np.asarray(jax.vmap(lambda a, sp, r: light.rd(Medium(a, sp, jnp.asarray(ETA)), r))(*medium[:2], r_mm))
    total_r = np.asarray(jax.vmap(lambda a, sp: light.total(Medium(a, sp, jnp.asarray(ETA))))(*medium[:2]))
    noisy = rd * (1 + 0.01 * rng.standard_normal(rd.shape))
    noisy_total = np.minimum(total_r * (1 + 0.002 * rng.standard_normal(batch)), 0.9999)
    return PeerProblem(r_mm, noisy, 0.01 * rd, noisy_total, 0.002 * total_r, ETA), sigma_a, sigma_sp


def _first(problem: PeerProblem, rows: int) -> PeerProblem:
    r_mm, rd, sd, total_r, total_r_sd = (each[:rows] for each in problem[:5])
    return PeerProblem(r_mm, rd, sd, total_r, total_r_sd, problem.eta)


def _ours(name: Literal["dipole", "mc"], constraint: Constraint, problem: PeerProblem) -> PeerFit:
    jobs = [
        Job((_slice(*row, problem.eta),), "X")
        for row in zip(problem.r_mm, problem.rd, problem.sd, problem.total_r, problem.total_r_sd, strict=True)
    ]
    options = FitOptions(constraint=constraint, tables="shipped")
    found: list[np.ndarray] = []
    # as the peers have it: all radii, each weighed by its own error alone
    bare = dipole(ETA)._replace(relative_error=0.0, window_mfp=(0.0, np.inf))
    model = bare if name == "dipole" else shipped_table(ETA, 0.0)

    def run() -> np.ndarray:
        point = fit_group(jobs, options, model).found.point
        found[:] = [each[:, 0] for each in coefficients(point.log_sigma, point.q)]
        return found[1]

    _, seconds = timed(run)
    return PeerFit(found[0], found[1], seconds / len(jobs))


def _slice(r: np.ndarray, rd: np.ndarray, sd: np.ndarray, total_r: float, total_sd: float, eta: float) -> Slice:
    return Slice(
        channels={"X": ChannelSlice(r, rd, sd)},
        eta=eta,
        g=0.0,
        flux="entering",
        exit="hemisphere",
        total_r={"X": float(total_r)},
        total_r_sd={"X": float(total_sd)},
        scale_rel_sd=0.0,
        mm_rel_sd=0.0,
    )


def _score(name: str, fitted: CameraFit, optimum: CameraFit | None) -> FitScore:
    answer, rows = fitted.found, len(fitted.found.sigma_a)
    error_sp = np.abs(answer.sigma_sp / fitted.sigma_sp[:rows] - 1)
    error_a = np.abs(answer.sigma_a / fitted.sigma_a[:rows] - 1)
    distance = None
    if optimum is not None:
        both = [each.sigma_a[:SLOW] + each.sigma_sp[:SLOW] for each in (answer, optimum.found)]
        distance = float(np.max(np.abs(both[0] / both[1] - 1)))
    return FitScore(
        name,
        1 / answer.seconds_each,
        float(np.nanmedian(error_sp)),
        float(np.nanquantile(error_sp, 0.9)),
        float(np.nanmedian(error_a)),
        float(np.nanquantile(error_a, 0.9)),
        answer.fails,
        distance,
    )


def _draw(path: Path, scores: list[FitScore]) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(
        xscale="log", yscale="log", xlabel="time per fit, s", ylabel="median relative error of σa"
    )
    axes.xaxis.set_minor_formatter("")  # they would run into each other
    axes.margins(x=0.25)
    for score in scores:
        axes.plot(1 / score.fits_per_second, score.sigma_a_median, "o")
        axes.annotate(
            score.method,
            (1 / score.fits_per_second, score.sigma_a_median),
            xytext=(5, 3),
            textcoords="offset points",
            fontsize=8,
        )
    figure.savefig(path, dpi=110)
