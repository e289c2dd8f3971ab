"""One-line mistakes of the physics and of the error propagation, each of which some law among the tests must catch.

`make mutants` makes each in a copy of the sources, runs the tests named beside it, and prints who caught it. A name on
the command line picks those mutants whose words hold it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "demo", "out")


@dataclass(frozen=True)
class Mutant:
    """A mistake, and the tests that must see it."""

    what: str
    file: str
    right: str
    """Stands exactly once in the file."""
    wrong: str
    tests: tuple[str, ...]
    """Files of tests/ without test_ and .py, with the start of a test's name."""

    @property
    def nodes(self) -> list[str]:
        return [f"tests/test_{name.replace('::', '.py::test_', 1)}" for name in self.tests]


PHYSICS = (
    Mutant(
        "Fresnel, JAX: index once instead of squared for p",
        "transport/fresnel.py",
        "_contrast(index * index * cos_i, cos_r)",
        "_contrast(index * cos_i, cos_r)",
        ("fresnel::both_sides_follow_fresnels_equations",),
    ),
    Mutant(
        "Fresnel, NumPy: reflectance of s light alone",
        "transport/light.py",
        "1 - (r_s * r_s + r_p * r_p) / 2, 0.0)",
        "1 - r_s * r_s, 0.0)",
        ("photon::fresnel_is_one_law",),
    ),
    Mutant(
        "Fresnel, numba: p light counts as s light",
        "transport/photon.py",
        "0.5 * (r_s * r_s + r_p * r_p), cos_outside",
        "r_s * r_s, cos_outside",
        ("photon::fresnel_is_one_law",),
    ),
    Mutant(
        "boundary A = 1/(1 − Fdr)",
        "transport/fresnel.py",
        "return (1 + reflected) / (1 - reflected)",
        "return 1 / (1 - reflected)",
        ("light::fresnel_in_numpy_is_fresnel_in_jax", "fresnel::the_boundary_by_reciprocity"),
    ),
    Mutant(
        "exit lobe without 1/C",
        "transport/bssrdf.py",
        "norm = 1 if paper else exit_norm(eta)",
        "norm = 1 if paper else 1",
        ("brdf::bssrdf_returns_the_exitant_light",),
    ),
    Mutant(
        "a camera's factor without 1/C",
        "transport/convention.py",
        "factor *= _transmittance(eta, view_angle_deg) / exit_norm(eta)",
        "factor *= _transmittance(eta, view_angle_deg)",
        ("convention::the_fresnel_exit_has_its_known_values",),
    ),
    Mutant(
        "dipole: virtual source at 2AD instead of 4AD",
        "transport/dipole.py",
        "self.z_r + 4 * boundary_a(self.eta) * self.diffusion",
        "self.z_r + 2 * boundary_a(self.eta) * self.diffusion",
        ("dipole::rd_integrates_to_the_closed_total",),
    ),
    Mutant(
        "dipole: a source falls as 1/d²",
        "transport/dipole.py",
        "diffuse_decay(_square(medium) * d * d) / d**3",
        "diffuse_decay(_square(medium) * d * d) / d**2",
        ("dipole::exitant_light_is_the_gradient",),
    ),
    Mutant(
        "dipole of the fits: decay without the 1 + σtr d",
        "transport/light.py",
        "value = value + flux",
        "value = value + pulse",
        ("light::a_look_is_the_model_s_curve",),
    ),
    Mutant(
        "phase function: forward and backward exchanged",
        "transport/single.py",
        "(1 + g * g - 2 * g * cos_theta) ** -1.5",
        "(1 + g * g + 2 * g * cos_theta) ** -1.5",
        ("single::the_curve_is_the_integral_over_depth",),
    ),
    Mutant(
        "walk: Henyey and Greenstein's cosine off by its g²",
        "transport/photon.py",
        "(1.0 + g * g - t * t) / (2.0 * g)",
        "(1.0 - t * t) / (2.0 * g)",
        ("photon::henyey_and_greenstein",),
    ),
    Mutant(
        "walk: what leaves counts whole at every meeting with the surface",
        "transport/walk.py",
        "out = weight * (1.0 - reflected)",
        "out = weight",
        ("engine::all_light_is_somewhere",),
    ),
    Mutant(
        "totals of half spaces: an order counts 2n instead of 2n + 1",
        "transport/discrete_ordinates.py",
        "moments = (2 * order + 1)",
        "moments = (2 * order)",
        ("engine::a_conservative_half_space_returns_all_light",),
    ),
    Mutant(
        "annuli of the fit: mean by dr instead of r dr",
        "transport/observed.py",
        "xp.where(from_zero, r, r * r)",
        "xp.where(from_zero, 1.0 + 0 * r, r)",
        ("fit_observe::an_annulus_is_the_model_s_mean",),
    ),
    Mutant(
        "spot of the fit: √2 too wide",
        "transport/observed.py",
        "np.sqrt(t / 2), angle",
        "np.sqrt(t), angle",
        ("fit_observe::the_spots_blur_is_the_mean_over_the_spot",),
    ),
    Mutant(
        "pixel area: times cos(view) instead of over it",
        "calib/surface.py",
        "across / np.cos(np.radians",
        "across * np.cos(np.radians",
        ("calib_geometry::pixel_areas_add_up",),
    ),
    Mutant(
        "bins of the measured curve: mean by dr instead of r dr",
        "measure/profile.py",
        "return (curve(r) * r * weights).sum(1) / (r * weights).sum(1)",
        "return (curve(r) * weights).sum(1) / (0 * r + weights).sum(1)",
        ("measure_blocks::a_bin_is_the_mean",),
    ),
    Mutant(
        "merge: darks are not subtracted",
        "measure/accumulate.py",
        "light = np.subtract(raw, dark, dtype=np.float32)",
        "light = np.subtract(raw, 0, dtype=np.float32)",
        ("merge::negatives_are_kept", "merge::a_clipped_black"),
    ),
    Mutant(
        "merge: Σt counts saturated samples too",
        "measure/accumulate.py",
        "seconds[at] += t if good is None else t * good",
        "seconds[at] += t",
        ("merge::a_clipped_black",),
    ),
    Mutant(
        "merge: saturated samples weigh like others",
        "measure/accumulate.py",
        "w = _kept(np.reciprocal(noise.variance(expected[at])), good)",
        "w = np.reciprocal(noise.variance(expected[at]))",
        ("merge::a_saturated_sample_is_left_out",),
    ),
    Mutant(
        "total reflectance: light beyond the frame is forgotten",
        "measure/reflectance.py",
        "light = inside + outside.value",
        "light = inside",
        ("measure_session::the_total_holds_the_light_beyond_the_frame",),
    ),
)

ERRORS = (
    Mutant(
        "(a) a length error forgets R_d's 1/mm²",
        "fit/laying.py",
        "response = _relative(e, looks[k][1], looks[k][0])",
        "response = _relative(e, looks[k][1], looks[k][0]) - 2",
        ("fit::a_length_error_moves_both", "fit_budget::a_share_of_the_budget"),
    ),
    Mutant(
        "(b) an error of scale leaves R where it is",
        "fit/laying.py",
        '(sds.scale,),\n        "view": lambda: (sds.view * by_view',
        '(0.0,),\n        "view": lambda: (sds.view * by_view',
        ("fit_budget::a_share_of_the_budget",),
    ),
    Mutant(
        "shared errors have no prior",
        "fit/terms.py",
        "[1.0] * len(plan.shared)",
        "[1e-9] * len(plan.shared)",
        ("fit_budget::a_share_of_the_budget",),
    ),
    Mutant(
        "an error of the view angle forgets the pixels' foreshortening",
        "fit/laying.py",
        "sds.view * (tilt + by_view)",
        "sds.view * by_view + 0",
        ("fit_budget::a_share_of_the_budget",),
    ),
    Mutant(
        "an error of η forgets the surface's transmittance in R",
        "fit/laying.py",
        'lambda: (sds.eta * (aside("eta") + by_eta),),\n'
        '        "g": lambda: (sds.g * aside("g"),),\n        "thickness": lambda: (sample.total',
        'lambda: (sds.eta * aside("eta"),),\n'
        '        "g": lambda: (sds.g * aside("g"),),\n        "thickness": lambda: (sample.total',
        ("fit_budget::a_share_of_the_budget",),
    ),
    Mutant(
        "exact: R's own error is dropped",
        "fit/errors.py",
        "error = np.where(np.isfinite(sd), sd, 0.0)",
        "error = 0.0 * sd",
        ("fit_budget::a_share_of_the_budget",),
    ),
    Mutant(
        "soft: R weighs by its sd instead of its variance",
        "fit/errors.py",
        "moved, error = np.matmul(answer, (row / sd**2)[:, :, None])[:, :, 0], sd",
        "moved, error = np.matmul(answer, (row / sd)[:, :, None])[:, :, 0], sd",
        ("fit_budget::a_share_of_the_budget",),
    ),
    Mutant(
        "noise: the model's allowance counts as noise",
        "fit/errors.py",
        "np.where(force > 0, force**2 * variance + unknown, 0.0)",
        "np.where(force > 0, force + unknown, 0.0)",
        ("fit_budget::the_share_of_noise",),
    ),
    Mutant(
        "σa goes as q instead of q²",
        "fit/neighbours.py",
        "np.stack([one, 2 / q], 1)",
        "np.stack([one, 1 / q], 1)",
        ("fit_budget::the_share_of_noise",),
    ),
    Mutant(
        "profile: both ends at the one-sided quantile",
        "fit/intervals.py",
        "TWO_SIDED = 3.841",
        "TWO_SIDED = 2.706",
        ("fit_budget::a_bound_of_sigma_a_is_where",),
    ),
    Mutant(
        "joint: slices against one tile draw their scales apart",
        "fit/jobs.py",
        "return tuple(ids.index(name) if name is not None else at for at, name in enumerate(ids))",
        "return tuple(range(len(ids)))",
        ("fit_joint::a_slice_cut_in_two",),
    ),
    Mutant(
        "merge: variance without the shot noise",
        "measure/accumulate.py",
        "return radiance * (1 / self.gain + self.model_var * self.t * radiance) + self.darkness / self.t",
        "return radiance * self.model_var * self.t * radiance + self.darkness / self.t",
        ("merge::the_variance_map_is_right",),
    ),
    Mutant(
        "bins: the error of a faded mean falls as its weights squared",
        "measure/profile.py",
        "share = np.where(clear, bin_model / modelled, 1 / weights)",
        "share = np.where(clear, bin_model / modelled, 1 / weights**2)",
        ("measure_blocks::bins_of_noise_alone",),
    ),
)

MUTANTS = PHYSICS + ERRORS


def copied(to: Path) -> Path:
    """The sources as a package of their own that comes before any installed one."""
    package = to / "bssrdf"
    shutil.copytree(ROOT, package, ignore=LEFT_OUT, symlinks=True)
    return package


@contextmanager
def made(mutant: Mutant, package: Path) -> Iterator[None]:
    """The mistake, for as long as this lasts."""
    path = package / mutant.file
    text = path.read_text(encoding="utf-8")
    if text.count(mutant.right) != 1:
        raise LookupError(f"{mutant.file}: holds {text.count(mutant.right)} times, not once:\n{mutant.right}")
    path.write_text(text.replace(mutant.right, mutant.wrong), encoding="utf-8")
    try:
        yield
    finally:
        path.write_text(text, encoding="utf-8")


def caught_by(mutant: Mutant, package: Path) -> str | None:
    """The first test that fails of it; None if it survives."""
    with made(mutant, package):
        return first_failure(package, [mutant], anew="numba" in (package / mutant.file).read_text(encoding="utf-8"))


def first_failure(package: Path, mutants: Sequence[Mutant], *, anew: bool = False) -> str | None:
    """Run the tests beside these mutants; with `anew` all that numba has cached is compiled again."""
    environment = os.environ | {"PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1"}
    if anew:  # a function's cache does not know that one which it calls has changed
        environment["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(dir=package.parent)
    nodes = [node.split("::") for mutant in mutants for node in mutant.nodes]
    chosen = [*dict.fromkeys(file for file, _ in nodes), "-k", " or ".join(dict.fromkeys(name for _, name in nodes))]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *chosen]
    done = subprocess.run(command, cwd=package, env=environment, capture_output=True, text=True, check=False)
    failed = re.search(r"^FAILED (\S+)", done.stdout, re.MULTILINE)
    if done.returncode not in (0, 1) or (done.returncode == 1 and not failed):
        raise RuntimeError(f"pytest ended with {done.returncode}\n{done.stdout}{done.stderr}")
    return failed[1].removeprefix("tests/") if failed else None


def main(words: list[str]) -> int:
    """Try the mutants whose text holds all words; 1 if one survives."""
    chosen = [mutant for mutant in MUTANTS if all(word in f"{mutant.what} {mutant.file}" for word in words)]
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        package = copied(Path(folder))
        if not chosen or (broken := first_failure(package, chosen)):
            print(f"{broken}: fails without any mutant" if chosen else f"no mutant holds {' '.join(words)}")
            return 1
        for mutant in chosen:
            begun = time.monotonic()
            killer = caught_by(mutant, package)
            survived += killer is None
            took = time.monotonic() - begun
            print(f"{mutant.file}: {mutant.what}\n  {killer or 'SURVIVED'} ({took:.0f} s)", flush=True)
    print(f"{len(chosen) - survived} of {len(chosen)} mutants caught")
    return int(survived > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
