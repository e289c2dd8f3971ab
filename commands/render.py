"""`bssrdf render`, `bssrdf compare` and `bssrdf doctor`."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, TypeVar

import click

from bssrdf import __version__
from bssrdf.commands.console import Command, fresh, is_quiet, warn
from bssrdf.errors import UsageError

if TYPE_CHECKING:
    from bssrdf.render import Goal, Model, RenderOptions
    from bssrdf.render.scenes.record import Scene

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
FILE = click.Path(path_type=Path)
_UNITS_S = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_GONE = {"--sampling": "radii are not drawn any more; --method says how the light under surfaces is found"}


class Duration(click.ParamType):
    """60s, 5min, 1h, or seconds."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """In seconds."""
        if isinstance(value, float):
            return value
        found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|min|h|)", str(value).strip())
        if found is None or float(found[1]) == 0:
            self.fail(f'"{value}" is not a time; give one as 60s, 5min or 1h', param, ctx)
        return float(found[1]) * _UNITS_S[found[2]]


def _gone(context: click.Context, option: click.Parameter, value: Any) -> None:
    if value is not None:
        raise UsageError(f"{option.opts[0]} is no more: {_GONE[option.opts[0]]}")


_OPTIONS = (
    click.option("--material", metavar="NAME_OR_FIT", help="A published material, Marble-half, or a fit.json."),
    click.option("--g", type=float, help="Mean cosine of the phase function, at the same σs′."),
    click.option("--mesh", type=FILE, help="bust, face: this figure (PLY, OBJ), z up and looking along −y."),
    click.option("--height-mm", type=float, help="Height that the mesh is scaled to (default: as it is, in mm)."),
    click.option("--light", type=click.Choice(["beam", "edge", "sky"]), help="slab: what it lies under."),
    click.option("--texture", "texture_path", type=FILE, help="texture: image that scales the albedo."),
    click.option(
        "--roughness", type=click.FloatRange(0, 1), help="Of GGX microfacets; 0 is polished (default: the scene's)."
    ),
    click.option(
        "--width", "width_px", type=click.IntRange(1, 16384), help="Pixels across (default: 1024; compare: 256)."
    ),
    click.option(
        "--method",
        type=click.Choice(["auto", "points", "walks"]),
        default="auto",
        show_default=True,
        help="How bssrdf finds the light under surfaces.",
    ),
    click.option(
        "--kernel",
        type=click.Choice(["table", "dipole"]),
        default="table",
        show_default=True,
        help="R_d of Monte Carlo, or the paper's dipole and single scattering.",
    ),
    click.option(
        "--quality",
        type=click.Choice(["draft", "final"]),
        default="final",
        show_default=True,
        help="Noise to stop at: 6 or 2 % on bodies.",
    ),
    click.option("--time", "time_s", type=Duration(), help="Use this much time instead, as 60s or 5min."),
    click.option("--samples", type=click.IntRange(2), help="Take as many samples per pixel instead."),
    click.option("--mc-depth", type=click.IntRange(2), default=1000, show_default=True, help="mc: most scatterings."),
    click.option("--seed", type=click.IntRange(0, 10_000), default=0, show_default=True),
    click.option(
        "--paper", is_flag=True, help="dipole: the exit Fresnel factor as printed, without its normalisation."
    ),
    click.option("--sampling", hidden=True, expose_value=False, is_eager=True, callback=_gone),
    click.option("--force", is_flag=True, help="Replace what stands at the output."),
)


def _scene_options(command: Decorated) -> Decorated:
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@click.command(cls=Command)
@click.argument("scene", metavar="SCENE")
@click.option(
    "--model",
    type=click.Choice(["auto", "brdf", "bssrdf", "mc"]),
    default="auto",
    show_default=True,
    help="auto is bssrdf, or brdf where light spreads less than a pixel's width.",
)
@click.option("--terms", metavar="LIST", help="dipole: of diffusion,single,specular, those to show.")
@click.option("--explain", is_flag=True, help="Say how --model and --method auto choose.")
@click.option("--out", type=FILE, metavar="STEM", help="STEM.exr and STEM.png are written (default: SCENE).")
@_scene_options
def render(scene: str, model: str, terms: str | None, explain: bool, out: Path | None, seed: int, **given: Any) -> None:
    """Render SCENE with the materials you measured.

    SCENE is slab, block, bust, milk, face, texture, or a Mitsuba .xml file.
    """
    from bssrdf.render import RULE, WHITE_PERCENTILE, write_pictures
    from bssrdf.render import render as render_picture
    from bssrdf.report import steps

    stem = out or Path(Path(scene).stem)
    stem = stem.with_suffix("") if stem.suffix.lower() in (".exr", ".png") else stem
    _refuse([stem.with_name(f"{stem.name}.{kind}") for kind in ("exr", "png")], given.pop("force"))
    goal, options = _goal(given), _options(given, terms, seed)
    subject = _subject(scene, given, 1024)
    if explain:
        click.echo(RULE, err=True)
    options = _with_model(subject, options, model)
    with _spoken(), steps(quiet=is_quiet()) as progress:
        picture = render_picture(subject, options, goal, seed=seed, progress=progress, say=_say)
    white = WHITE_PERCENTILE if isinstance(subject, Path) else subject.white_percentile
    for path in write_pictures(stem, picture, _provenance(scene, subject, options, picture.samples, seed), white):
        click.echo(str(path))
    click.echo(
        f"{options.model}: {picture.samples} samples per pixel, noise {picture.noise:.1%}, "
        f"{picture.prepare_s:.1f} s + {picture.seconds + picture.compile_s:.1f} s"
    )


@click.command(cls=Command)
@click.argument("scene", metavar="SCENE")
@click.option("--mc-samples", type=click.IntRange(2), help="Samples per pixel of mc (default: as many as bssrdf).")
@click.option("--out", type=FILE, metavar="FOLDER", help="Folder for the pictures (default: SCENE-compare).")
@_scene_options
def compare(scene: str, out: Path | None, mc_samples: int | None, seed: int, **given: Any) -> None:
    """Render SCENE by brdf, bssrdf and mc, side by side.

    Pictures, their difference, errors and times.
    """
    from bssrdf.render import compare_models, mc_refusal, mc_remarks, scores_text, write_comparison
    from bssrdf.report import steps
    from bssrdf.session import replace_folder

    folder = out or Path(f"{Path(scene).stem}-compare")
    _refuse([folder], given.pop("force"))
    goal, options = _goal(given), _options(given, None, seed)
    subject = _subject(scene, given, 256)
    refusal = "a .xml file holds no medium for mc" if isinstance(subject, Path) else mc_refusal(subject)
    if refusal:
        warn(f"{refusal}: bssrdf is the reference")
    elif not isinstance(subject, Path):
        for remark in mc_remarks(subject):
            warn(remark)
    models: tuple[Model, ...] = ("brdf", "bssrdf") if refusal else ("brdf", "bssrdf", "mc")
    with _spoken(), steps(quiet=is_quiet()) as progress:
        pictures, scores = compare_models(
            subject, options, models, goal=goal, mc_samples=mc_samples, seed=seed, progress=progress
        )
    samples = pictures["bssrdf"].samples
    with replace_folder(folder) as part:
        write_comparison(part, pictures, scores, _provenance(scene, subject, options, samples, seed))
    click.echo(f"{scores_text(scores)}\n{folder}")


@click.command(cls=Command)
def doctor() -> None:
    """What is installed and usable.

    Libraries, libLLVM, GPU, serial ports and cameras.
    """
    from bssrdf.report import doctor_text, examine, stages

    with stages("looking", quiet=is_quiet()):
        findings = examine()
    click.echo(doctor_text(findings))


@contextmanager
def _spoken() -> Iterator[None]:
    """Warnings of the integrator, such as of an open mesh, once and as a line each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for line in dict.fromkeys(str(each.message) for each in caught if each.category is UserWarning):
        warn(line)


def _refuse(paths: list[Path], force: bool) -> None:
    for path in paths:
        if not fresh(path, force).parent.is_dir():
            raise UsageError(f"{path.parent} is not a folder; make it first, or choose another --out")
        try:
            TemporaryFile(dir=path.parent).close()
        except OSError as error:
            raise UsageError(f"{path.parent} cannot be written to ({error.strerror}); choose another --out") from error


def _goal(given: dict[str, Any]) -> Goal:
    """When the picture is done: by samples, by time, or at the noise of the quality."""
    from bssrdf.render import QUALITIES, Goal

    samples, time_s = given.pop("samples"), given.pop("time_s")
    if samples is not None and time_s is not None:
        raise UsageError("--samples and --time both say when to stop; give one")
    if samples is None and time_s is None:
        return QUALITIES[given["quality"]].goal
    return Goal(noise=0.0, samples=samples, time_s=time_s)


def _options(given: dict[str, Any], terms: str | None, seed: int) -> RenderOptions:
    from bssrdf.render import QUALITIES, TERMS, RenderOptions

    wanted = TERMS if terms is None else tuple(term.strip() for term in terms.split(","))
    for term in wanted:
        if term not in TERMS:
            raise UsageError(f'term "{term}" is not one of {", ".join(TERMS)}')
    for name, asked in (("--terms", terms), ("--paper", given["paper"])):
        if asked and given["kernel"] != "dipole":
            raise UsageError(f"{name} is of the paper's model; add --kernel dipole")
    quality = QUALITIES[given.pop("quality")]
    return RenderOptions(
        terms=wanted,
        light_samples=quality.light_samples,
        walks=quality.walks,
        seed=seed,
        **{name: given.pop(name) for name in ("kernel", "method", "paper", "mc_depth")},
    )


def _say(line: str) -> None:
    if not is_quiet():
        click.echo(line, err=True)


def _subject(scene: str, given: dict[str, Any], width_px: int) -> Scene | Path:
    """A built-in scene with what can be wrong about it said, or the path of a Mitsuba file."""
    from bssrdf.render import remarks
    from bssrdf.render.scenes.catalogue import build_scene

    if scene.endswith(".xml"):
        extra = [name for name, value in given.items() if value]
        if extra:
            option = extra[0].removesuffix("_px").removesuffix("_path").replace("_", "-")
            raise UsageError(f"{scene} describes itself; leave out --{option}")
        return Path(scene)
    mesh, height_mm = given["mesh"], given["height_mm"]
    if height_mm is not None and mesh is None:
        raise UsageError("--height-mm scales a --mesh; give one")
    own = {"light": given["light"], "texture_path": given["texture_path"], "mesh": _mesh(mesh, height_mm)}
    named = {name: given[name] for name in ("material", "g", "roughness")}
    built = build_scene(scene, **named, width_px=given["width_px"] or width_px, own=own)
    for remark in remarks(built):
        warn(remark)
    return built


def _mesh(path: Path | None, height_mm: float | None) -> Any:
    if path is None:
        return None
    from bssrdf.render import read_mesh

    mesh, remarks = read_mesh(path, height_mm=height_mm)
    for remark in remarks:
        warn(remark)
    return mesh


def _with_model(subject: Scene | Path, options: RenderOptions, model: str) -> RenderOptions:
    """The options with the model that was asked for, or that `auto` chooses."""
    from dataclasses import replace

    from bssrdf.render import choose_model, mc_refusal, mc_remarks

    chosen: Any = model
    if isinstance(subject, Path):
        if model == "mc":
            raise UsageError(
                f"{subject}: --model mc needs a built-in scene; render the file with volpathmis in mitsuba"
            )
        chosen = "bssrdf" if model == "auto" else model
    elif model == "auto":
        chosen, reason = choose_model(subject)
        _say(f"auto: {chosen} ({reason})")
    elif model == "mc" and (refusal := mc_refusal(subject)):
        raise UsageError(f"{refusal}; use a wider light, or --model bssrdf")
    elif model == "mc":
        for remark in mc_remarks(subject):
            warn(remark)
    if chosen == "mc" and len(options.terms) < 3:
        raise UsageError("mc has no terms to show apart; use --model bssrdf or brdf with --terms")
    return replace(options, model=chosen)


def _provenance(scene: str, subject: Scene | Path, options: RenderOptions, samples: int, seed: int) -> dict[str, Any]:
    """What made the picture, for its file."""
    from dataclasses import asdict
    from importlib.metadata import version

    from bssrdf.session import sha256_of

    facts: dict[str, Any] = {"software": f"bssrdf {__version__}, mitsuba {version('mitsuba')}", "scene": scene}
    if isinstance(subject, Path):
        facts["sha256"] = sha256_of(subject)
    else:
        facts["materials"] = {name: asdict(body.material) for name, body in subject.bodies.items()}
        facts["camera"] = asdict(subject.camera)
    return facts | {"options": asdict(options), "samples": samples, "seed": seed}
