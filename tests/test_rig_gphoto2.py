"""What cameras say, and what libgphoto2 brings of it."""

from __future__ import annotations

import pytest

from bssrdf.rig.gphoto2_camera import exposure_seconds


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1/8000", 1 / 8000),
        ("1/4000.0", 1 / 4000),
        ("0.0001s", 1e-4),
        ("0,0002s", 2e-4),
        ("30", 30),
        ("30s", 30),
        ("1/2.5", 0.4),
        ("10/25", 0.4),
        (" 1/60 ", 1 / 60),
        ('0"4', 0.4),
        ('1"', 1),
        ('1"3', 1.3),
        ("2m", 120),
        ("1e-3", 1e-3),
        ("300/10", 30),
        ("1/1", 1),
        *((text, None) for text in ("bulb", "Bulb", "Time", "auto", "B", "x 1/250", "-1", "", "0", "0.0000s", "1/0")),
        *((text, None) for text in ("65535/65535", "4294967295/4294967295", '1.5"4', "1/250/2", "nan", "1e999")),
    ],
)
def test_exposure_times_are_read_in_every_cameras_words(text: str, seconds: float | None) -> None:
    assert exposure_seconds(text) == (seconds if seconds is None else pytest.approx(seconds))
