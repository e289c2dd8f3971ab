"""The published material table."""

import numpy as np
import pytest

from bssrdf.errors import InputError
from bssrdf.transport.materials import find_material, load_materials, table_check, table_source


def test_the_table_is_the_papers() -> None:
    materials = load_materials()
    names = "Apple Chicken1 Chicken2 Cream Ketchup Marble Potato Skimmilk Skin1 Skin2 Spectralon Wholemilk"
    assert " ".join(materials) == names
    assert materials["Chicken1"].sigma_a_per_mm[0] == 0.015
    assert materials["Chicken2"].sigma_a_per_mm[0] == 0.018
    assert {name for name, material in materials.items() if material.eta != 1.3} == {"Marble"}
    sums = np.sum([[m.sigma_sp_per_mm, m.sigma_a_per_mm, m.total_r] for m in materials.values()], axis=0)
    np.testing.assert_allclose(sums, [[29.74, 39.01, 32.77], [0.1492, 1.3992, 2.6826], [8.01, 6.82, 5.34]], atol=1e-9)
    assert "2001" in table_source()


def test_coefficients_and_reflectance_agree_in_all_cells_but_one() -> None:
    rows = table_check()
    assert len(rows) == 36
    off = [row for row in rows if abs(row.difference) > 0.01]
    assert [(row.name, row.channel, row.published) for row in off] == [("Chicken1", "B", 0.10)]
    assert off[0].computed == pytest.approx(0.126, abs=5e-4)
    assert off[0].difference == pytest.approx(0.026, abs=5e-4)


def test_names_are_found_in_any_case() -> None:
    marble = find_material("marble")
    assert marble.medium("G") == (0.0041, 2.62, 1.5)
    assert find_material("SKIN1").name == "Skin1"


@pytest.mark.parametrize(("name", "said"), [("marbel", "use Marble"), ("granite", "Apple, .*Wholemilk"), ("", '""')])
def test_an_unknown_name_says_which_there_are(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        find_material(name)
