"""The bench of slices with faults says what became of each."""

from __future__ import annotations

import pytest

from bssrdf.bench import sabotaged_slices as bench


def test_what_is_wrong_with_a_slice_is_refused_or_the_truth_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "MEDIA", {"skin": bench.MEDIA["skin"]})
    monkeypatch.setattr(bench, "STEPS", 2e7)
    found = {name.removeprefix("skin, "): how for name, how, _ in bench.judged("dipole", seed=3)}
    assert set(found) == {"none", *bench.FAULTS}
    assert found["none"] == "holds"
    assert found["R of another sample"] == found["curve x 1.5"] == "rejected"
    assert "WRONG" not in (found["noise understated"], found["radii in cm"], found["a floor of glare"])
