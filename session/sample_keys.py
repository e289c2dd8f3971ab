"""What holds a sample: keys that are the same in `[material]` and in a slice."""

from __future__ import annotations

from typing import Annotated, Literal

from bssrdf.session.checks import backing
from bssrdf.session.keys import ERROR, LENGTH, SHARE, Key

Thickness = Annotated[
    float | None, Key("depth of the sample; without it, and without a dish, a half space", LENGTH, example=40.0)
]
ThicknessSd = Annotated[float | None, Key("error of the depth; none is taken as 2 %, flagged", ERROR, example=0.4)]
Width = Annotated[float | None, Key("inner diameter of a round dish with the beam on its axis", LENGTH, example=100.0)]
Wall = Annotated[
    Literal["black", "air"] | None, Key("side of the dish: painted, or clear against air", example="black")
]
Backing = Annotated[
    str | float | None,
    Key(
        'under the sample: "black", "air", or the diffuse reflectance of a face in optical contact; any other word is '
        "flagged and not allowed for",
        example="black",
        check=backing,
    ),
]
BackingSd = Annotated[
    float | None,
    Key("error of that reflectance; none is taken as 0.05, of black as 0.03, flagged", SHARE, example=0.02),
]
Cover = Annotated[Literal["none", "glass"], Key("what lies on top")]

SAMPLE_KEYS = ("thickness_mm", "thickness_sd_mm", "width_mm", "wall", "backing", "backing_sd", "cover")
