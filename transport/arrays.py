"""The two ways to run one text of array operations: NumPy at once, or JAX compiled for large batches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np

State = TypeVar("State")
Fixed = TypeVar("Fixed")


KEPT = 24 << 20
"""Bytes of a block that is given back untouched: the C library then keeps freed memory of up to that size at hand.
Else each array of a large batch is mapped anew, and half of the time goes into faulting in its pages."""


class ById:
    """Something built once and kept, such as a model with its tables, as a key of what is made for it."""

    def __init__(self, it: Any) -> None:
        self.it = it

    def __hash__(self) -> int:
        return id(self.it)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ById) and self.it is other.it


class Engine(Protocol):
    """What the text needs of the array library that runs it."""

    @property
    def xp(self) -> Any:
        """The namespace: numpy or jax.numpy."""
        ...

    @property
    def special(self) -> Any:
        """That of special functions: scipy's or jax's."""
        ...

    def loop(
        self, go_on: Callable[[State], Any], body: Callable[[State, Fixed], State], state: State, fixed: Fixed
    ) -> State:
        """`body` applied to each row as long as `go_on` (b,) holds for it. The arrays of the state and of what is fixed
        have a row first."""
        ...

    def take(self, rows: Any, cell: Any) -> tuple[Any, ...]:
        """rows (b, k, n) at cell (b, p): k arrays (b, p)."""
        ...

    def chosen(self, test: Any, a: State, b: State) -> State:
        """By row `a` where the test (b,) holds, else `b`, through tuples of arrays."""
        ...

    def needed(self, test: Any, made: Callable[[], Any], otherwise: Any) -> Any:
        """What is made (b,), unless the test holds for no row and nobody will ask."""
        ...


class NumpyEngine:
    """For up to some thousand curves: nothing is compiled."""

    def __init__(self) -> None:
        np.empty(KEPT, np.uint8)

    @property
    def xp(self) -> Any:
        return np

    @property
    def special(self) -> Any:
        from scipy import special

        return special

    @staticmethod
    def loop(go_on: Callable[[State], Any], body: Callable[[State, Fixed], State], state: State, fixed: Fixed) -> State:
        whole, rows = state, np.empty(0, int)
        while (on := go_on(state)).any():
            if not on.all():  # those that are done leave
                if rows.size:
                    _put(whole, rows[~on], picked(state, ~on))
                else:
                    whole = replaced(state, [], picked(state, []))  # a copy
                stay = np.flatnonzero(on)
                rows = rows[stay] if rows.size else stay
                state, fixed = picked((state, fixed), stay)
            state = body(state, fixed)
        if not rows.size:
            return state
        _put(whole, rows, state)
        return whole

    @staticmethod
    def take(rows: Any, cell: Any) -> tuple[Any, ...]:
        b, k, n = rows.shape
        flat = np.ascontiguousarray(rows).reshape(-1)
        at = cell + (k * n * np.arange(b))[:, None]
        return tuple(flat[i * n :].take(at) for i in range(k))  # four times as fast as rows[:, i][row, cell]

    @staticmethod
    def chosen(test: Any, a: State, b: State) -> State:
        if test.all():
            return a
        return _chosen(np, test, a, b) if test.any() else b

    @staticmethod
    def needed(test: Any, made: Callable[[], Any], otherwise: Any) -> Any:
        return made() if test.any() else otherwise


class JaxEngine:
    """For batches: one compilation for each shape; safe under jit and grad."""

    def __init__(self) -> None:
        import jax
        import jax.numpy as jnp

        self._xp = jnp
        self._while: Any = jax.lax.while_loop

    @property
    def xp(self) -> Any:
        return self._xp

    @property
    def special(self) -> Any:
        from jax.scipy import special

        return special

    def loop(
        self, go_on: Callable[[State], Any], body: Callable[[State, Fixed], State], state: State, fixed: Fixed
    ) -> State:
        def step(s: State) -> State:
            return self.chosen(go_on(s), body(s, fixed), s)

        looped: State = self._while(lambda s: go_on(s).any(), step, state)
        return looped

    def take(self, rows: Any, cell: Any) -> tuple[Any, ...]:
        b, k, n = rows.shape
        flat = self.xp.asarray(rows).reshape(-1)
        at = cell + (k * n * self.xp.arange(b, dtype=cell.dtype))[:, None]
        return tuple(flat.at[at + i * n].get(mode="promise_in_bounds") for i in range(k))

    def chosen(self, test: Any, a: State, b: State) -> State:
        return _chosen(self.xp, test, a, b)

    def needed(self, test: Any, made: Callable[[], Any], otherwise: Any) -> Any:
        return made()


def _chosen(xp: Any, test: Any, a: Any, b: Any) -> Any:
    if a is b:
        return b
    if isinstance(b, tuple):
        made = [_chosen(xp, test, x, y) for x, y in zip(a, b, strict=True)]
        return type(b)(*made) if hasattr(b, "_fields") else tuple(made)
    return xp.where(test.reshape((-1,) + (1,) * (b.ndim - 1)), a, b)


def picked(tree: Any, rows: Any) -> Any:
    """Some rows of the arrays in nested tuples and dicts, one that stands twice picked once; all else stays."""
    made: dict[int, Any] = {}

    def of(each: Any) -> Any:
        if isinstance(each, tuple):
            parts = [of(part) for part in each]
            return type(each)(*parts) if hasattr(each, "_fields") else tuple(parts)
        if isinstance(each, dict):
            return {name: of(part) for name, part in each.items()}
        if not isinstance(each, np.ndarray):
            return each
        if id(each) not in made:
            made[id(each)] = each[rows]
        return made[id(each)]

    return of(tree)


def _put(tree: Any, rows: Any, new: Any) -> None:
    """Some rows from another, in place."""
    if isinstance(tree, tuple):
        for old, each in zip(tree, new, strict=True):
            _put(old, rows, each)
    elif isinstance(tree, np.ndarray):
        tree[rows] = new


def replaced(tree: Any, rows: Any, new: Any) -> Any:
    """The same with some rows from another."""
    if isinstance(tree, tuple):
        made = [replaced(old, rows, each) for old, each in zip(tree, new, strict=True)]
        return type(tree)(*made) if hasattr(tree, "_fields") else tuple(made)
    if not isinstance(tree, np.ndarray):
        return tree
    whole = tree.copy()
    whole[rows] = new
    return whole


NUMPY = NumpyEngine()
