"""Tables made on demand: announced, kept whole or not at all, and refused when they are not what they claim."""

import subprocess
import sys

import jax
import numpy as np
import pytest

from bssrdf.errors import InputError
from bssrdf.transport.dipole import Medium
from bssrdf.transport.discrete_ordinates import half_space
from bssrdf.transport.white import store
from bssrdf.transport.white.archive import TableSet, read_tables, write_tables
from bssrdf.transport.white.store import allowed, nearest, place, shipped, table_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def made(folder):
    told = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "SEED", 5)
        model = table_model(1.6, -0.2, directory=folder, core_seconds=3.0, announce=told.append)
    [path] = folder.iterdir()
    return model, path, told


def test_a_table_made_on_demand_is_announced_and_right(made):
    model, _, told = made
    assert told == [pytest.approx(store.seconds_to_make(3.0))]
    with jax.enable_x64(True):
        medium = Medium(0.1, 0.9, 1.6)
        exact = half_space(0.9 / 1.2 / (0.9 / 1.2 + 0.1), -0.2, 1.6, np.array([1.0])).total
        assert float(model.total(medium)) == pytest.approx(exact, rel=1e-3)
        edges = np.append(0, np.geomspace(1e-3, 50, 200))
        total = np.sum(np.asarray(model.bin_average(medium, edges[:-1], edges[1:])) * np.pi * np.diff(edges**2))
        assert total == pytest.approx(exact, rel=1e-3)


def test_the_second_time_it_is_read(made, folder):
    told = []
    again = table_model(1.6, -0.2, directory=folder, core_seconds=3.0, announce=told.append)
    assert told == []
    assert np.array_equal(again.log_curve, made[0].log_curve)


def test_tables_survive_the_file(made, tmp_path):
    tables = read_tables(made[1])
    write_tables(tmp_path / "copy.npz", tables)
    assert all(np.array_equal(a, b) for a, b in zip(tables, read_tables(tmp_path / "copy.npz"), strict=True))


@pytest.mark.parametrize("keep", [0, 10, 0.5, -1])
def test_a_truncated_file_is_refused(made, tmp_path, keep):
    whole = made[1].read_bytes()
    cut = tmp_path / "cut.npz"
    cut.write_bytes(whole[: int(keep * len(whole)) if isinstance(keep, float) else keep])
    with pytest.raises(InputError, match=r"cut\.npz: not a table .* delete it"):
        read_tables(cut)


def test_a_changed_value_is_refused(made, tmp_path):
    with np.load(made[1]) as stored:
        arrays = dict(stored)
    arrays["log_curve"] = arrays["log_curve"] + np.float32(1e-3)
    np.savez_compressed(tmp_path / "changed.npz", **arrays)
    with pytest.raises(InputError, match="checksum"):
        read_tables(tmp_path / "changed.npz")


@pytest.mark.parametrize(("key", "value", "message"), [("kind", "photos", "photos"), ("format", 99, "format 99")])
def test_a_foreign_file_is_refused(made, tmp_path, key, value, message):
    with np.load(made[1]) as stored:
        arrays = dict(stored)
    np.savez_compressed(tmp_path / "foreign.npz", **arrays | {key: value})
    with pytest.raises(InputError, match=message):
        read_tables(tmp_path / "foreign.npz")


def test_a_pickle_is_not_opened(tmp_path):
    np.savez(tmp_path / "evil.npz", kind=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match=r"evil\.npz: not a table"):
        read_tables(tmp_path / "evil.npz")


def test_the_table_of_another_medium_is_refused(made, folder, tmp_path):
    (tmp_path / "white-eta1.7-g-0.2.npz").write_bytes(made[1].read_bytes())
    with pytest.raises(InputError, match="another medium"):
        table_model(1.7, -0.2, directory=tmp_path)


def test_a_writer_that_is_killed_leaves_no_table(tmp_path):
    script = f"""
import os, signal
from pathlib import Path
import numpy as np
from bssrdf.transport.white import archive
from bssrdf.transport.white.store import shipped
os.fsync = lambda fd: os.kill(os.getpid(), signal.SIGKILL)
archive.write_tables(Path({str(tmp_path / "white.npz")!r}), shipped())
"""
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == -9
    assert not (tmp_path / "white.npz").exists()


def test_a_writer_that_fails_leaves_nothing(tmp_path, monkeypatch):
    tables = TableSet(*(np.zeros(1) for _ in TableSet._fields))
    monkeypatch.setattr("os.fsync", lambda fd: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_tables(tmp_path / "white.npz", tables)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("eta", "g", "message"),
    [(0.9, 0.0, "eta = 0.9"), (1.3, 1.0, "g = 1.0"), (1.3, -1.0, "g = -1.0"), (float("nan"), 0, "eta")],
)
def test_media_without_a_table_are_refused_by_value(eta, g, message, tmp_path):
    with pytest.raises(InputError, match=message):
        table_model(eta, g, directory=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_table_is_placed_where_table_model_would_take_it_from(made, folder, tmp_path):
    assert place(1.37, 0.5).origin == "shipped"
    assert place(1.6, -0.2, directory=folder) == ("cached", 1.6, -0.2, 0.0, False)
    elsewhere = place(1.6, -0.2, directory=tmp_path)
    assert (elsewhere.origin, elsewhere.seconds) == ("made", store.seconds_to_make())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("g", "taken"), [(0.97, 0.95), (0.95, 0.95), (-0.97, -0.9)])
def test_g_is_drawn_into_the_range_of_the_tables_and_says_so(g, taken, tmp_path):
    found = place(1.4, g, directory=tmp_path)
    assert (found.g, found.g_clamped) == (taken, g != taken)


def test_a_policy_lets_through_what_it_names(made, folder, tmp_path):
    places = [place(1.4, 0.5), place(1.6, -0.2, directory=folder), place(1.6, -0.2, directory=tmp_path)]
    assert [[allowed(found, policy) for found in places] for policy in ("shipped", "cached", "make")] == [
        [True, False, False],
        [True, True, False],
        [True, True, True],
    ]


def test_the_nearest_table_is_a_shipped_one_or_one_made_before(made, folder, tmp_path):
    assert nearest(1.4, 0.5, directory=tmp_path) == (1.4, 0.5, True)
    assert nearest(1.62, -0.25, directory=folder) == (1.6, -0.2, True)
    assert nearest(1.62, -0.25, directory=folder, policy="shipped")[:2] != (1.6, -0.2)


def test_beyond_a_fifth_in_eta_or_three_tenths_in_g_no_table_is_near(tmp_path):
    last = max(load().etas[-1] for load in store.SHIPPED)
    assert nearest(last + 0.19, 0.5, directory=tmp_path).near
    assert not nearest(last + 0.21, 0.5, directory=tmp_path).near
    assert nearest(1.4, shipped().gs[0] - 0.29, directory=tmp_path).near
    assert not nearest(1.4, shipped().gs[0] - 0.31, directory=tmp_path).near
