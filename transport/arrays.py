"""The two ways to run one text of array operations: NumPy at once, or JAX compiled for large batches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np

State = TypeVar("State")


class Engine(Protocol):
    """What the text needs of the array library that runs it."""

    @property
    def xp(self) -> Any:
        """The namespace: numpy or jax.numpy."""
        ...

    def loop(self, go_on: Callable[[State], Any], body: Callable[[State], State], state: State) -> State:
        """`body` applied as long as `go_on` holds for any row."""
        ...

    def take(self, rows: Any, cell: Any) -> tuple[Any, ...]:
        """rows (b, k, n) at cell (b, p): k arrays (b, p)."""
        ...


class NumpyEngine:
    """For up to some thousand curves: nothing is compiled."""

    @property
    def xp(self) -> Any:
        return np

    @staticmethod
    def loop(go_on: Callable[[State], Any], body: Callable[[State], State], state: State) -> State:
        while go_on(state).any():
            state = body(state)
        return state

    @staticmethod
    def take(rows: Any, cell: Any) -> tuple[Any, ...]:
        row = np.arange(rows.shape[0])[:, None]
        return tuple(rows[:, k][row, cell] for k in range(rows.shape[1]))


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

    def loop(self, go_on: Callable[[State], Any], body: Callable[[State], State], state: State) -> State:
        looped: State = self._while(lambda s: go_on(s).any(), body, state)
        return looped

    def take(self, rows: Any, cell: Any) -> tuple[Any, ...]:
        b, k, n = rows.shape
        flat = self.xp.asarray(rows).reshape(-1)
        at = cell + (k * n * self.xp.arange(b, dtype=cell.dtype))[:, None]
        return tuple(flat.at[at + i * n].get(mode="promise_in_bounds") for i in range(k))


NUMPY = NumpyEngine()
