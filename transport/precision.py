"""Floating-point precision: double inside one call, without touching JAX's global switch."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeAlias, TypeVar

import jax
from jax import Array

P = ParamSpec("P")
T = TypeVar("T")

Real: TypeAlias = Array | float
"""A number or an array; arrays broadcast by equal rank, else with an explicit axis of length 1."""


def scoped_x64(fn: Callable[P, T]) -> Callable[P, T]:
    """`fn` run with JAX in float64, for public calls whose caller may not have enabled it."""

    @functools.wraps(fn)
    def in_x64(*args: P.args, **kwargs: P.kwargs) -> T:
        with jax.enable_x64(True):
            return fn(*args, **kwargs)

    return in_x64
