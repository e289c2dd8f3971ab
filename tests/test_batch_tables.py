"""Tables walked by several processes have the bits of one."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from bssrdf.batch import sample_on
from bssrdf.transport import WhiteSamples, batches, merged


def test_a_cluster_walks_the_same_bits() -> None:
    pytest.importorskip("distributed")
    etas, per_batch = np.array([1.3]), np.ones(8, int)
    alone = merged(0.5, etas, per_batch, [batches(0.5, etas, per_batch, at, seed=3) or [] for at in range(3)])
    many = sample_on("local:2", 0.5, etas, per_batch, seed=3, n_batches=3)
    for field in fields(WhiteSamples):
        if field.name != "seconds":
            np.testing.assert_array_equal(getattr(many, field.name), getattr(alone, field.name))
    assert alone.curve.any()
    other = merged(0.5, etas, per_batch, [batches(0.5, etas, per_batch, at, seed=4) or [] for at in range(3)])
    assert (other.curve != alone.curve).any()
