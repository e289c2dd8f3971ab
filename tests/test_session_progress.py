"""Copying and checking frames takes seconds where they are large: each one done is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile

from bssrdf.session import counted, ingest_folder, verify_session

KINDS = ("sample", "sample_dark", "reference", "reference_dark")


def test_each_frame_that_is_copied_and_then_checked_is_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for kind in KINDS:
        (tmp_path / "in" / kind).mkdir(parents=True)
        tifffile.imwrite(tmp_path / "in" / kind / "8ms.tif", rng.integers(100, 900, (40, 60)).astype(np.uint16))
    told: list[tuple[str, int, int]] = []

    def progress(what: str, done: int, total: int) -> None:
        told.append((what, done, total))

    ingest_folder(tmp_path / "in", tmp_path / "out", camera={"layout": "mono"}, progress=progress)
    verify_session(tmp_path / "out", progress=progress)
    assert told == [(what, done, 4) for what in ("copy", "verify") for done in (1, 2, 3, 4)]


def test_a_step_is_told_when_it_is_done_and_not_before() -> None:
    told: list[int] = []
    for item in counted([1, 2, 3], "count", lambda _, done, __: told.append(done)):
        assert told == list(range(1, item))
    assert told == [1, 2, 3]
