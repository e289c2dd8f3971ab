"""Double precision inside a call, and no global switch."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from bssrdf.transport.precision import scoped_x64


@pytest.mark.parametrize("outside", [True, False])
def test_a_call_is_double_and_the_caller_keeps_its_own(outside: bool) -> None:
    @scoped_x64
    def third(x: float) -> jax.Array:
        return jnp.asarray(x) / 3

    with jax.enable_x64(outside):
        assert third(1.0).dtype == jnp.float64
        assert jax.config.jax_enable_x64 == outside


def test_the_switch_comes_back_after_an_error() -> None:
    @scoped_x64
    def fail() -> None:
        raise ValueError

    with jax.enable_x64(False):
        with pytest.raises(ValueError):  # noqa: PT011
            fail()
        assert not jax.config.jax_enable_x64


def test_importing_changes_no_setting_of_jax() -> None:
    code = (
        "import jax; before = dict(jax.config.values);"
        "import bssrdf.transport.bssrdf, bssrdf.transport.materials, bssrdf.transport.convention;"
        "assert dict(jax.config.values) == before"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
