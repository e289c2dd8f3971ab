"""What `bssrdf bench export` found: numbers of pictures beside what they should be."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class EdgePoint:
    """One number of a picture beside what it should be."""

    renderer: str
    kept: str
    material: str
    channel: str
    depth: float | None
    """Into the shadow in 1/σtr, negative in the light; None for the total under an even sky."""
    measured: float
    predicted: float
    """What the file says it will be."""
    rendered: float
    se: float
    """From the scatter of pixels."""
    paths: int

    @property
    def off(self) -> float:
        """Relative to the measured medium."""
        return self.rendered / self.measured - 1

    @property
    def off_predicted(self) -> float:
        """Relative to what the file says."""
        return self.rendered / self.predicted - 1

    @property
    def noise(self) -> float:
        """Two relative standard errors; in a shadow not less than those of as many paths, of which few find light."""
        least = math.sqrt(self.predicted / self.paths) if self.depth is not None and self.depth > 0 else 0.0
        return 2 * max(self.se, least) / self.predicted


def table(points: Sequence[EdgePoint], skipped: Sequence[str]) -> str:
    """Totals, with the verbatim coefficients beside them, and edges."""
    lines = [
        "R under an even sky, off the measured one, ± two standard errors [%];",
        "in brackets: coefficients exported as they are",
    ]
    totals = [point for point in points if point.depth is None]
    for key in dict.fromkeys((point.renderer, point.material) for point in totals):
        here = [point for point in totals if (point.renderer, point.material) == key]
        kept = [point for point in here if point.kept != "verbatim"]
        as_is = [f"{100 * point.off:+.0f}" for point in here if point.kept == "verbatim"]
        told = "  ".join(f"{100 * point.off:+.2f} ± {100 * point.noise:.1f}" for point in kept)
        lines.append(f"{_short(key[0]):<13} {key[1]:<10} {told}" + (f" ({' '.join(as_is)})" if as_is else ""))
    edges = [point for point in points if point.depth is not None]
    if edges:
        lines += ["", "Edge of a shadow, worst beyond two standard errors: when lit; to 1.5/σtr into"]
        lines += ["the shadow; off what the file says, to 3.2/σtr"]
    for edge in dict.fromkeys((point.renderer, point.material, point.channel) for point in edges):
        here = [point for point in edges if (point.renderer, point.material, point.channel) == edge]
        lines.append(
            f"{_short(edge[0]):<13} {edge[1]:<10} {edge[2]}  " + "  ".join(f"{100 * x:.1f} %" for x in worst(here))
        )
    return "\n".join([*lines, *(f"skipped {line}" for line in skipped)])


def _short(renderer: str) -> str:
    return renderer.removesuffix(" LTS")


def worst(edge: Sequence[EdgePoint]) -> tuple[float, float, float]:
    """Beyond two standard errors: off the measured light when lit and to 1.5/σtr, anywhere off the file's."""

    def most(values: Iterator[float]) -> float:
        return max((value for value in values), default=0.0)

    depths = [(point.depth or 0.0, point) for point in edge]
    return (
        most(abs(point.off) - point.noise for depth, point in depths if depth < 0),
        most(abs(point.off) - point.noise for depth, point in depths if 0 < depth <= 1.5),
        most(abs(point.off_predicted) - point.noise for _, point in depths),
    )
