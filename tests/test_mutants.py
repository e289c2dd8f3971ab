"""The mutants of `make mutants`: each still has its line and its tests; in the slow suite each is caught."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from mutants import ERRORS, MUTANTS, PHYSICS, ROOT, Mutant, caught_by, copied


def test_physics_and_error_propagation_are_both_tried() -> None:
    assert len(PHYSICS) >= 9
    assert len(ERRORS) >= 6
    assert len({mutant.what for mutant in MUTANTS}) == len(MUTANTS)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.what)
def test_the_line_to_change_and_the_tests_to_run_exist(mutant: Mutant) -> None:
    text = (ROOT / mutant.file).read_text(encoding="utf-8")
    assert text.count(mutant.right) == 1, f"{mutant.file}: {mutant.right}"
    assert mutant.wrong != mutant.right
    for node in mutant.nodes:
        file, name = node.split("::")
        assert re.search(rf"^def {name}\w*\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), node


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copied(tmp_path_factory.mktemp("mutants"))


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.what)
def test_a_mutant_is_caught(mutant: Mutant, package: Path) -> None:
    assert caught_by(mutant, package)
