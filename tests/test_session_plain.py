"""Data classes to what JSON holds, and back."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from bssrdf.session.plain import from_plain, to_plain


class Inner(NamedTuple):
    by_time: dict[float, float]
    matrix: NDArray[np.float64]


@dataclass(frozen=True)
class Outer:
    name: str
    pairs: tuple[float, ...]
    inner: dict[str, Inner]
    maybe: float | None
    number: int


@given(st.lists(st.floats(allow_nan=False)), st.dictionaries(st.floats(allow_nan=False), st.floats(allow_nan=False)))
def test_a_value_comes_back_to_the_last_bit(pairs: list[float], by_time: dict[float, float]) -> None:
    value: Any = Outer("a", tuple(pairs), {"x": Inner(by_time, np.eye(2))}, None, 3)
    back = from_plain(Outer, json.loads(json.dumps(to_plain(value))))
    assert (back.name, back.pairs, back.maybe, back.number) == (value.name, value.pairs, None, 3)
    assert back.inner["x"].by_time == by_time
    np.testing.assert_array_equal(back.inner["x"].matrix, np.eye(2))


def test_an_array_is_one_under_an_alias_as_numpy_has_it_from_2_5_on() -> None:
    T = TypeVar("T")
    alias: Any = TypeAliasType("alias", np.ndarray[tuple[Any, ...], np.dtype[T]], type_params=(T,))  # type: ignore[type-var]
    np.testing.assert_array_equal(from_plain(alias[np.float64], [[1.0, 2.0]]), np.array([[1.0, 2.0]]))
