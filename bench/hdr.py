"""`bssrdf bench hdr`: speed and error of the merge, beside other tools, on one made-up scene in one run.

Thirteen exposures of 1 ms to 4.1 s, six decades of radiance with a coloured fall-off, three channels. Every method
gets the same 16-bit frames; those that know no dark frames get them with the black level taken off.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.sensor import Sensor
from bssrdf.measure.merge import Hdr, Progress, Sample, Shot, merge

Plane = NDArray[np.float32]

EXPOSURES_S = tuple(0.001 * 2**k for k in range(13))
SENSOR = Sensor(black_dn=512.0, saturation_dn=65000.0, gain_e_per_dn=1.0, read_noise_e=3.0)
WHITE_DN = 65535
DARK_E_PER_S = 2.0
DECADES = 6
_PEAK_SHARE = 0.9
"""Of the range, that the brightest pixel fills in the shortest exposure."""
_FALLOFF = (0.92, 1.0, 1.08)
"""Steepness by channel."""


@dataclass(frozen=True)
class Scene:
    """True radiance [DN/s] of shape (h, w, 3), the frames that show it and their dark frames."""

    radiance: Plane
    frames: list[NDArray[np.uint16]]
    darks: list[NDArray[np.uint16]]

    def shots(self) -> list[Shot]:
        """The frames as the merge takes them."""
        return [
            Shot(f"{number:02d}", t, partial(Sample, frame, dark, 1))
            for number, (frame, dark, t) in enumerate(zip(self.frames, self.darks, EXPOSURES_S, strict=True))
        ]


@dataclass(frozen=True)
class Score:
    """How one method did; by decade of radiance, the brightest first, in relative errors."""

    method: str
    seconds: float
    peak_mib: float
    rms: list[float]
    bias: list[float]


@dataclass(frozen=True)
class HdrBench:
    """All scores, the least possible error by decade, and how right our variance map is."""

    bound: list[float]
    scores: list[Score]
    chi2: float
    skipped: dict[str, str]
    """Why a method was left out."""


def make_scene(height: int = 800, width: int = 1200, seed: int = 0) -> Scene:
    """A spot whose radiance falls by six decades towards the corners, faster in blue than in red."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    depth = DECADES * np.hypot(x, y) / np.sqrt(2)
    peak = _PEAK_SHARE * (WHITE_DN - SENSOR.black_dn) / EXPOSURES_S[0]
    radiance = np.stack([peak * 10 ** (-depth * steep) for steep in _FALLOFF], axis=-1).astype(np.float32)
    frames = [_expose(radiance, t, rng) for t in EXPOSURES_S]
    darks = [_expose(np.zeros_like(radiance), t, rng) for t in EXPOSURES_S]
    return Scene(radiance, frames, darks)


def _expose(radiance: Plane, exposure_s: float, rng: np.random.Generator) -> NDArray[np.uint16]:
    electrons = rng.poisson((radiance + DARK_E_PER_S) * exposure_s).astype(np.float32)
    electrons += rng.standard_normal(radiance.shape, np.float32) * SENSOR.read_noise_e
    return np.clip(np.rint(electrons / SENSOR.gain_e_per_dn) + SENSOR.black_dn, 0, WHITE_DN).astype(np.uint16)


def bound(radiance: Plane) -> Plane:
    """Least relative error of any unbiased estimate from the frames and their darks (Cramér–Rao), by pixel."""
    information = np.zeros_like(radiance)
    for t in EXPOSURES_S:
        light, dark = radiance * t / SENSOR.gain_e_per_dn, DARK_E_PER_S * t / SENSOR.gain_e_per_dn
        usable = radiance * t + DARK_E_PER_S * t + SENSOR.black_dn < SENSOR.saturation_dn
        information += usable * np.float32(t) ** 2 / (light + 2 * dark + 2 * SENSOR.read_var_dn())
    return np.asarray(1 / np.sqrt(information) / radiance, np.float32)


def run_hdr_bench(
    height: int = 800, width: int = 1200, *, out: Path | None = None, progress: Progress | None = None
) -> HdrBench:
    """Merge one scene by every method there is; write `hdr.json` and `hdr.png` into the folder `out`, if given."""
    scene = make_scene(height, width)
    decade = np.minimum(np.log10(scene.radiance.max() / scene.radiance).astype(np.int8), DECADES - 1)
    scores, skipped = [], {}
    chi2 = np.nan
    for number, (name, method) in enumerate(METHODS.items()):
        if progress:
            progress(name, number, len(METHODS))
        try:
            with _watched() as watch:
                merged = method(scene)
        except ImportError as missing:
            skipped[name] = f"{missing.name} is not installed"
            continue
        if isinstance(merged, Hdr):
            chi2 = float(np.nanmean((merged.radiance - scene.radiance) ** 2 / merged.variance))
            merged = merged.radiance
        scores.append(Score(name, watch.seconds, watch.peak_mib, *_by_decade(merged / scene.radiance - 1, decade)))
    least = [float(np.sqrt(np.mean(bound(scene.radiance)[decade == d] ** 2))) for d in range(DECADES)]
    bench = HdrBench(least, scores, chi2, skipped)
    if out is not None:
        _write(bench, out)
    return bench


def _by_decade(error: Plane, decade: NDArray[np.int8]) -> tuple[list[float], list[float]]:
    """RMS and mean of a relative error in each decade."""
    parts = [error[(decade == d) & np.isfinite(error)] for d in range(DECADES)]
    return [float(np.sqrt(np.mean(part**2))) for part in parts], [float(np.mean(part)) for part in parts]


def _ours(scene: Scene) -> Hdr:
    return merge(scene.shots(), SENSOR)


def _above_black(scene: Scene) -> list[NDArray[np.uint16]]:
    """Frames without their black level; clipped where saturated, as the other tools expect."""
    black = int(SENSOR.black_dn)
    return [
        np.where(frame >= SENSOR.saturation_dn, WHITE_DN, np.maximum(frame, black) - black).astype(np.uint16)
        for frame in scene.frames
    ]


def _opencv(create: str) -> Callable[[Scene], Plane]:
    def run(scene: Scene) -> Plane:
        import cv2

        times = np.array(EXPOSURES_S, np.float32)
        linear = np.repeat(np.arange(WHITE_DN + 1, dtype=np.float32)[:, None, None], 3, axis=2)
        linear[0] = 1
        return np.asarray(getattr(cv2, create)().process(_above_black(scene), times, linear), np.float32)

    return run


def _colour_hdri(scene: Scene) -> Plane:
    import colour_hdri

    stack = colour_hdri.ImageStack()
    for frame, t in zip(_above_black(scene), EXPOSURES_S, strict=True):
        metadata = colour_hdri.Metadata(np.array(1.0), np.array(t), np.array(100.0))
        image = colour_hdri.Image("frame", metadata)
        image.data = frame.astype(np.float32) / WHITE_DN
        stack.append(image)
    merged = colour_hdri.image_stack_to_HDRI(stack, colour_hdri.weighting_function_Debevec1997)
    at_one_second = 1 / colour_hdri.average_luminance(np.array(1.0), np.array(1.0), np.array(100.0))
    return np.asarray(merged, np.float32) * np.float32(WHITE_DN * at_one_second)


def _ccdproc(scene: Scene) -> Plane:
    import ccdproc
    from astropy import units
    from astropy.nddata import CCDData

    signal, seconds = [], []
    for frame, dark, t in zip(scene.frames, scene.darks, EXPOSURES_S, strict=True):
        data, dark_data = (CCDData(x.astype(np.float32), unit=units.adu) for x in (frame, dark))
        exposure = t * units.second
        clean = ccdproc.subtract_dark(
            data, dark_data, dark_exposure=exposure, data_exposure=exposure, exposure_unit=units.second
        )
        clean.mask = frame >= SENSOR.saturation_dn
        signal.append(clean)
        seconds.append(CCDData(np.full(frame.shape, t, np.float32), unit=units.second, mask=clean.mask))
    total = ccdproc.combine(signal, method="sum")
    time_total = ccdproc.combine(seconds, method="sum")
    return np.asarray(total.data / time_total.data, np.float32)


METHODS: dict[str, Callable[[Scene], Hdr | Plane]] = {
    "bssrdf": _ours,
    "OpenCV MergeDebevec": _opencv("createMergeDebevec"),
    "OpenCV MergeRobertson": _opencv("createMergeRobertson"),
    "colour-hdri": _colour_hdri,
    "ccdproc": _ccdproc,
}


@contextmanager
def _watched() -> Iterator[SimpleNamespace]:
    """Wall time of the block, and by how much the process grew meanwhile [MiB]; NaN where /proc is not there."""
    watch = SimpleNamespace(seconds=np.nan, peak_mib=np.nan)
    stop = threading.Event()
    before = _resident_mib()
    peak = [before]

    def look() -> None:
        while not stop.wait(0.002):
            peak[0] = max(peak[0], _resident_mib())

    thread = threading.Thread(target=look)
    thread.start()
    start = time.perf_counter()
    try:
        yield watch
    finally:
        watch.seconds = time.perf_counter() - start
        stop.set()
        thread.join()
        watch.peak_mib = max(peak[0], _resident_mib()) - before


def _resident_mib() -> float:
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, IndexError):
        return float("nan")
    return pages * 4096 / 2**20


def table(bench: HdrBench) -> str:
    """The scores as a Markdown table, errors in percent."""
    head = "| method | s | MiB | " + " | ".join(f"RMS {d + 1}" for d in range(DECADES)) + " | largest bias |"
    lines = [head, "|---" * (DECADES + 4) + "|"]
    lines.append("| bound | | | " + " | ".join(f"{100 * b:.3f}" for b in bench.bound) + " | |")
    for score in bench.scores:
        errors = " | ".join(f"{100 * rms:.3f}" for rms in score.rms)
        bias = 100 * max(score.bias, key=abs)
        lines.append(f"| {score.method} | {score.seconds:.2f} | {score.peak_mib:.0f} | {errors} | {bias:+.2f} |")
    lines += [f"| {name} | {reason} |" for name, reason in bench.skipped.items()]
    return "\n".join([*lines, "", f"Mean χ² of the variance map: {bench.chi2:.3f}"])


def _write(bench: HdrBench, out: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    (out / "hdr.json").write_text(json.dumps(asdict(bench), indent=1) + "\n", encoding="utf-8")
    figure = Figure(figsize=(6, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(
        xlabel="seconds", ylabel="RMS error over the bound, worst decade", xscale="log", yscale="log"
    )
    for score in bench.scores:
        worst = max(rms / least for rms, least in zip(score.rms, bench.bound, strict=True))
        axes.plot(score.seconds, worst, "o")
        axes.annotate(score.method, (score.seconds, worst), textcoords="offset points", xytext=(6, 3))
    axes.axhline(1, lw=0.8, color="0.5")
    figure.savefig(out / "hdr.png", dpi=110)
