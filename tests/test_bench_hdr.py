"""The merge beside OpenCV's, on a small scene of six decades."""

import tracemalloc

import pytest

from bssrdf.bench.hdr import run_hdr_bench, table
from bssrdf.bench.hdr_scene import SENSOR, make_scene
from bssrdf.measure.hdr import merge


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return run_hdr_bench(260, 400, rounds=1, out=tmp_path_factory.mktemp("bench"))


def test_our_error_is_the_least_possible_in_every_decade(bench):
    ours = bench.scores[0]
    for rms, least, bias in zip(ours.rms, bench.bound, ours.bias, strict=True):
        assert rms < 1.02 * least
        assert abs(bias) < 1e-3
    assert bench.chi2 == pytest.approx(1, abs=0.02)


def test_no_other_method_has_a_smaller_error(bench):
    for other in bench.scores[1:]:
        assert max(b / a for a, b in zip(bench.scores[0].rms, other.rms, strict=True)) > 1.1, other.method
    assert "OpenCV MergeDebevec" in table(bench)


def test_the_merge_needs_a_few_planes_whatever_the_number_of_frames():
    scene = make_scene(400, 600)
    plane = scene.radiance.nbytes
    tracemalloc.start()
    merge(scene.shots(), SENSOR)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * plane
