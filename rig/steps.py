"""From a plan to the list of frames to take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from bssrdf.errors import InputError
from bssrdf.rig.plan_toml import CapturePlan, Subject
from bssrdf.session.records import FrameKind

_DARK: dict[Subject, FrameKind] = {"sample": "sample_dark", "reference": "reference_dark"}
_FARTHEST_STOPS = 0.5
"""A time that the camera cannot come nearer to is refused."""


class Step(NamedTuple):
    """One frame to take."""

    name: str
    """File name without suffix; it says number, kind and time."""
    kind: FrameKind
    exposure_s: float

    @property
    def subject(self) -> Subject:
        return "sample" if self.kind.startswith("sample") else "reference"

    @property
    def lit(self) -> bool:
        return not self.kind.endswith("_dark")


def snapped(asked_s: Sequence[float], offered_s: Sequence[float]) -> tuple[float, ...]:
    """The camera's nearest exposure times, descending, each once; InputError where one is over half a stop off."""
    if not offered_s:
        return tuple(sorted(set(asked_s), reverse=True))
    nearest = set()
    for asked in asked_s:
        got = min(offered_s, key=lambda offered: abs(math.log2(offered / asked)))
        if abs(math.log2(got / asked)) > _FARTHEST_STOPS:
            raise InputError(
                f"plan.toml: exposure {asked:g} s is not one of the camera's: it offers {min(offered_s):g} to "
                f"{max(offered_s):g} s; change the plan"
            )
        nearest.add(got)
    return tuple(sorted(nearest, reverse=True))


def steps_of(plan: CapturePlan, exposures_s: dict[Subject, tuple[float, ...]]) -> list[Step]:
    """Every frame in its order: longest exposures first, so that each frame tells what the next must show.

    With `drift_check` the reference stands before the sample, and its first frame and the sample's are taken again at
    the end.
    """
    subjects: list[Subject] = list(plan.kinds)
    drift = plan.drift_check and len(subjects) == 2
    if drift:
        subjects = ["reference", "sample"]
    frames = [frame for subject in subjects for frame in _bracket(plan, subject, exposures_s[subject])]
    if plan.drift_check:
        again: list[Subject] = ["reference", "sample"] if drift else subjects[:1]
        frames += [(subject, exposures_s[subject][0]) for subject in again]
    return [
        Step(f"{number:03d}_{kind}_{1000 * exposure_s:g}ms", kind, exposure_s)
        for number, (kind, exposure_s) in enumerate(frames, 1)
    ]


def _bracket(plan: CapturePlan, subject: Subject, exposures_s: tuple[float, ...]) -> list[tuple[FrameKind, float]]:
    times = [exposure_s for exposure_s in exposures_s for _ in range(plan.repeats)]
    if plan.order == "blocks":
        return [(subject, time) for time in times] + [(_DARK[subject], time) for time in times]
    return [(kind, time) for time in times for kind in (subject, _DARK[subject])]
