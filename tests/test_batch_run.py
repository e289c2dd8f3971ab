"""A batch loses nothing that is finished, does nothing twice, and gives one table whoever does the work."""

from __future__ import annotations

import ast
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
from filmed import edit, film, marble
from many_curves import files_of, plain, rich

from bssrdf.batch import THREADS, Named, read_fits_of, write_slices
from bssrdf.batch.inputs import find_inputs
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.fit import fit_slice
from bssrdf.session.fit_json import read_fit
from bssrdf.session.slice_csv import read_slice

COMMAND = [sys.executable, "-m", "bssrdf", "batch"]


def bssrdf(*arguments: object) -> int:
    return run(cli, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def slices(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight slices, two of which cannot be used."""
    folder = tmp_path_factory.mktemp("slices")
    files_of(folder, {f"s{at}.csv": plain((1.3, 1.5)[at % 2], seed=at) for at in range(8)})
    (folder / "s3.csv").write_text("nonsense\n")
    (folder / "s5.csv").write_text((folder / "s5.csv").read_text().replace("# eta = 1.5\n", ""))
    return folder


@pytest.fixture(scope="module")
def table(slices: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What an undisturbed batch says of them."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    assert bssrdf("batch", slices, "--stages", "fit", "--out", out, "--chunk", 2) == 3
    return tables(out)


@pytest.fixture(scope="module")
def parquet(slices: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Those that can be used in one file, and one that cannot be fitted."""
    pytest.importorskip("pyarrow")
    file = tmp_path_factory.mktemp("parquet") / "all.parquet"
    bad = replace(plain(), total_r={"R": 3.0})
    with write_slices(file) as write:
        write([Named(f"s{at}", "", plain((1.3, 1.5)[at % 2], seed=at)) for at in range(6)] + [Named("bad", "", bad)])
    return file


def tables(out: Path) -> bytes:
    names = ("results.csv", "failures.csv", "fits/*.parquet")
    return b"".join(file.read_bytes() for name in names for file in sorted(out.glob(name)))


def chunks(out: Path) -> dict[Path, tuple[int, int]]:
    """The finished chunks, each with what changes when it is written again."""
    return {file: (file.stat().st_ino, file.stat().st_mtime_ns) for file in out.glob(".batch/*/*.json")}


def content(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(file.relative_to(folder)): (file.stat().st_mtime_ns, file.read_bytes() if file.is_file() else b"")
        for file in folder.rglob("*")
    }


def test_each_result_is_that_of_the_input_alone_and_failures_are_rows(
    slices: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, out = content(slices), tmp_path / "out"
    assert bssrdf("batch", slices, "--stages", "fit", "--out", out) == 3
    said = capsys.readouterr()
    assert said.err.count("\n") == 2
    assert f"{slices / 's3.csv'}: " in said.err
    assert "8 inputs; 2 failed" in said.out
    assert content(slices) == before
    for at in (0, 1, 2, 4, 6, 7):
        alone = fit_slice(read_slice(slices / f"s{at}.csv"))
        for name, channel in read_fit(out / f"s{at}" / "fit.json").channels.items():
            assert channel.status == alone[name].status
            assert channel.sigma_a_per_mm == pytest.approx(alone[name].sigma_a_per_mm, rel=1e-9, nan_ok=True)
    failures = (out / "failures.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in failures] == ["name", "s3", "s5"]


def test_nothing_that_is_finished_is_done_again_and_what_changed_is(slices: Path, tmp_path: Path) -> None:
    own, out = tmp_path / "own", tmp_path / "out"
    own.mkdir()
    for file in slices.glob("*.csv"):
        (own / file.name).write_bytes(file.read_bytes())
    command = ("batch", own, "--stages", "fit", "--out", out, "--chunk", 2)
    assert bssrdf(*command) == 3
    first, times = chunks(out), {file: file.stat().st_mtime_ns for file in out.glob("*/fit.json")}
    assert len(first) == 4
    assert bssrdf(*command) == 3
    assert chunks(out) == first
    (own / "s5.csv").write_bytes((own / "s7.csv").read_bytes())
    assert bssrdf(*command) == 3
    redone = [file.name for file, mark in chunks(out).items() if first[file] != mark]
    assert redone == ["000002.json"]
    assert all(file.stat().st_mtime_ns == at for file, at in times.items())
    assert (out / "s5" / "fit.json").is_file()
    assert bssrdf(*command, "--model", "dipole") == 3
    assert not set(chunks(out).items()) & set(first.items())


def test_another_list_of_inputs_keeps_what_is_known(slices: Path, tmp_path: Path) -> None:
    own, out = tmp_path / "own", tmp_path / "out"
    files_of(own, {f"s{at}.csv": plain(seed=at) for at in range(3)})
    command = ("batch", own, "--stages", "fit", "--out", out, "--chunk", 2)
    assert bssrdf(*command) == 0
    times = {file: file.stat().st_mtime_ns for file in out.glob("*/fit.json")}
    files_of(own, {"a.csv": plain(seed=9)})
    assert bssrdf(*command) == 0
    assert all(file.stat().st_mtime_ns == at for file, at in times.items())
    assert len((out / "results.csv").read_text().splitlines()) == 1 + 4 * 2


@pytest.mark.parametrize(
    ("what", "kills"),
    [("slices", 3), *(pytest.param(what, 50, marks=pytest.mark.slow) for what in ("slices", "parquet"))],
)
def test_kills_at_any_moment_lose_no_finished_chunk(
    request: pytest.FixtureRequest, tmp_path: Path, what: str, kills: int
) -> None:
    command = [*COMMAND, str(request.getfixturevalue(what)), "--stages", "fit", "--chunk", "1", "--quiet"]
    began = time.monotonic()
    assert subprocess.run([*command, "--out", str(tmp_path / "whole")], timeout=300).returncode == 3
    took, table, moments = time.monotonic() - began, tables(tmp_path / "whole"), random.Random(kills)
    folders = (tmp_path / str(number) for number in count())
    out, known, partly, least = next(folders), {}, 0, kills // 10
    while kills:
        process = subprocess.Popen([*command, "--out", str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            assert process.wait(moments.uniform(0.2, 1.0) * took) == 3
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            kills -= 1
        found = chunks(out)
        assert known.items() <= found.items()
        took *= 1.2 if found == known else 1.0  # a loaded machine must not be killed in its start each time
        partly += 0 < len(found) < len(chunks(tmp_path / "whole"))
        known = found
        if process.returncode == 3:
            assert tables(out) == table
            out, known = next(folders), {}
            took *= 0.8  # nor one that is less loaded by now be left to end each time
    done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 3, done.stderr
    assert known.items() <= chunks(out).items()
    assert tables(out) == table
    assert partly >= least


def test_rows_of_a_parquet_file_are_fitted_as_by_fit_and_only_what_is_lost_is_done_again(
    parquet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, at_once = tmp_path / "out", tmp_path / "fits.parquet"
    command = ("batch", parquet, "--stages", "fit", "--out", out, "--chunk", 3)
    assert bssrdf(*command) == 3
    said = capsys.readouterr()
    assert "14 curves; 1 failed" in said.out
    assert said.err.count("slice bad: total_r = {'R': 3.0}") == 1
    assert bssrdf("fit", parquet, "--out", at_once) == 3
    assert [repr(each) for each in read_fits_of(out / "fits")] == [repr(each) for each in read_fits_of(at_once)]
    assert [line.split(",")[0] for line in (out / "failures.csv").read_text().splitlines()] == ["name", "bad"]
    first, table = chunks(out), tables(out)
    assert len(first) == 3
    (out / "fits" / "all-000001.parquet").unlink()
    assert bssrdf(*command) == 3
    assert [file.name for file, mark in chunks(out).items() if first[file] != mark] == ["000001.json"]
    assert tables(out) == table
    assert bssrdf(*command[:-1], 7) == 3
    assert len([*(out / "fits").iterdir()]) == 1


def test_a_parquet_file_that_cannot_be_cut_is_refused_before_the_work(
    parquet: Path, slices: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    doubled, empty = tmp_path / "doubled.parquet", tmp_path / "empty.parquet"
    with write_slices(doubled) as write:
        write([Named(name, "", plain()) for name in "aba"])
    with write_slices(empty) as write:
        write([])
    assert bssrdf("fit", parquet, "--out", parquet.with_name("fits.parquet"), "--quiet") == 3
    capsys.readouterr()
    for what, stages, code, said in (
        ((doubled,), "fit", 3, "slice a stands in two places; sort the rows by name"),
        ((empty,), "fit", 3, "holds no slice"),
        ((parquet.with_name("fits.parquet"),), "fit", 3, "holds fits already; give the Parquet file of their slices"),
        ((parquet, slices), "fit", 2, "give such files by themselves, and --stages fit"),
        ((parquet,), "measure,fit", 2, "give such files by themselves, and --stages fit"),
    ):
        assert bssrdf("batch", *what, "--stages", stages, "--out", tmp_path / "out") == code
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        assert said in lines[0]
        assert not (tmp_path / "out").exists()


def descendants(pid: int) -> Iterator[tuple[int, int, str]]:
    """Processes below the process: their id, their parent's and their command."""
    stats = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError):
            continue
        stats[int(folder.name)] = (parent, words)
    below = {pid}
    while new := {own for own, (parent, _) in stats.items() if parent in below} - below:
        below |= new
    yield from ((own, *stats[own]) for own in below if own != pid)


@pytest.mark.skipif(sys.platform != "linux", reason="the worker is found in /proc")
def test_a_lost_worker_changes_nothing(slices: Path, table: bytes, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    command = [*COMMAND, str(slices), "--stages", "fit", "--out", str(out), "--chunk", "1", "--cluster", "local:2"]
    process = subprocess.Popen([*command, "--quiet"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 120
    killed = False
    while not killed and process.poll() is None and time.monotonic() < until:
        if chunks(out):
            workers = [parent for _, parent, words in descendants(process.pid) if "bssrdf.batch.child" in words]
            if workers:
                os.kill(workers[0], signal.SIGKILL)
                killed = True
        time.sleep(0.02)
    _, said = process.communicate(timeout=240)
    assert killed
    assert process.returncode == 3, said
    assert tables(out) == table


def test_compiled_code_obeys_the_number_of_threads_of_a_worker() -> None:
    tell = "import numba, numpy, threadpoolctl as t; print(numba.config.NUMBA_NUM_THREADS, t.threadpool_info())"
    done = subprocess.run(
        [sys.executable, "-c", tell], env=os.environ | dict.fromkeys(THREADS, "1"), capture_output=True, text=True
    )
    count, libraries = done.stdout.split(" ", 1)
    assert count == "1", done.stderr
    assert [each["num_threads"] for each in ast.literal_eval(libraries)] == [1]


def test_a_worker_over_its_memory_is_named_and_its_input_done_next_time(
    slices: Path, table: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ("batch", slices, "--stages", "fit", "--out", out, "--chunk", 8)
    assert bssrdf(*command, "--memory", "1MB") == 3
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 8
    assert all("takes more than the 0.001 GB that a worker may" in line for line in lines)
    assert bssrdf(*command) == 3
    assert tables(out) == table


@pytest.mark.parametrize("what", ["slices", "parquet"])
def test_a_full_disk_ends_the_batch_and_keeps_what_is_finished(
    request: pytest.FixtureRequest, what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    disk, source = tmp_path / "disk", request.getfixturevalue(what)
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=96k", "tmpfs", disk], capture_output=True).returncode:
        pytest.skip("a small tmpfs cannot be mounted here")
    command = ("batch", source, "--stages", "fit", "--chunk", 1, "--out")
    try:
        assert bssrdf(*command, disk / "out") == 3
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        assert "No space left on device" in lines[0]
        kept = chunks(disk / "out")
        assert kept
        subprocess.run(["mount", "-o", "remount,size=8m", disk], check=True)
        assert bssrdf(*command, disk / "out") == 3
        assert kept.items() <= chunks(disk / "out").items()
        assert bssrdf(*command, tmp_path / "roomy") == 3
        assert tables(disk / "out") == tables(tmp_path / "roomy")
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


def test_a_scheduler_that_cannot_be_reached_is_one_line(
    slices: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("bssrdf.batch.cluster._TIMEOUT_S", 0.5)
    out = tmp_path / "out"
    assert bssrdf("batch", slices, "--stages", "fit", "--out", out, "--cluster", "tcp://127.0.0.1:9") == 4
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "--cluster tcp://127.0.0.1:9: cannot be reached" in lines[0]
    for wrong in ("local:0", "local:many", "http://x", "nonsense"):
        assert bssrdf("batch", slices, "--stages", "fit", "--out", out, "--cluster", wrong) == 2


def test_an_input_is_found_once_by_whatever_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("one/a.csv", "two/a.csv", "one/._a.csv", "one/.trash/b.csv", "one/out/.batch/c.csv", "one/out/c.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    (tmp_path / "one" / "loop").symlink_to(".")
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / "day").symlink_to("../two")
    (tmp_path / "list.txt").write_bytes("\ufeff# mine\r\none/a.csv\r\n\r\n  two/../one/a.csv \r\n".encode())
    for what, names in (
        (["one", "one/../two/a.csv"], ["one-a", "two-a"]),
        (["links"], ["a"]),
        (["list.txt"], ["a"]),
        (["one/out"], ["c"]),
    ):
        assert [item.name for item in find_inputs(what, ["fit"], 1)] == names
    (tmp_path / "list.txt").write_text("one/a.csv\nnone.csv\n")
    with pytest.raises(InputError, match=r"list\.txt: lists none\.csv, which is not there"):
        find_inputs(["list.txt"], ["fit"], 1)


def test_what_is_wrong_is_named_where_it_can_be_mended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = tmp_path / "session"
    files_of(session / "measured", {"slice.csv": plain()})
    (session / "session.toml").write_text("[[[")
    assert bssrdf("batch", session, "--stages", "fit", "--out", tmp_path / "out") == 3
    assert f"bssrdf: {session / 'session.toml'}: is not TOML" in capsys.readouterr().err


def test_wrong_calls_are_one_line(slices: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    for arguments, code, said in (
        ((slices, "--stages", "fit", "--out", tmp_path / "full"), 2, "is not the folder of a batch"),
        ((slices, "--stages", "fits", "--out", tmp_path / "out"), 2, "--stages fits is not known"),
        ((slices, "--out", tmp_path / "out"), 3, "holds no session.toml; give sessions"),
        ((tmp_path / "none", "--out", tmp_path / "out"), 3, "is not there"),
        ((tmp_path / "empty", "--stages", "fit", "--out", tmp_path / "out"), 3, "holds no session.toml and no slice"),
        ((slices / "s0.csv", "--out", tmp_path / "out"), 3, "is a file; give sessions"),
        ((slices, "--stages", "fit", "--out", tmp_path / "out", "--memory", "lots"), 2, "write a size such as 2GB"),
    ):
        assert bssrdf("batch", *arguments) == code
        assert said in capsys.readouterr().err


def test_the_page_is_sorted_by_verdict_and_escapes_what_it_is_told(tmp_path: Path) -> None:
    odd = replace(plain(), material="<script>alert(1)</script>")
    files_of(tmp_path / "in", {"good.csv": odd, "hopeless.csv": replace(rich(), flags=())})
    (tmp_path / "in" / "zero.csv").write_text("x")
    assert bssrdf("batch", tmp_path / "in", "--stages", "fit", "--model", "dipole", "--out", tmp_path / "out") == 3
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.index(">zero<") < page.index(">hopeless<") < page.index(">good<")
    assert "<script>alert" not in page
    assert "1 error, 1 unidentifiable, 1 converged" in page


def test_sessions_are_measured_where_they_lie_and_stay_untouched(tmp_path: Path) -> None:
    frames, session = tmp_path / "frames" / "marble", tmp_path / "sessions" / "marble"
    scene = marble()
    film(scene, frames)
    (frames / "stone").rename(frames / "sample")
    (frames / "tile").rename(frames / "reference")
    assert bssrdf("ingest", frames, "--out", session) == 0
    edit(session / "session.toml", scene)
    (frames / "session.toml").write_bytes((session / "session.toml").read_bytes())
    before = content(tmp_path / "sessions")
    for what, stages, out in (
        ([tmp_path / "sessions"], "measure,fit,report", "here"),
        ([f"file://{session}", frames], "ingest,measure", "there"),
    ):
        assert bssrdf("batch", *what, "--stages", stages, "--out", tmp_path / out) == 0
    assert content(tmp_path / "sessions") == before
    assert bssrdf("measure", session) == 0
    by_hand = (session / "measured" / "slice.csv").read_bytes()
    measured = [*tmp_path.glob("*here/*/measured/slice.csv")]
    assert len(measured) == 3
    assert all(file.read_bytes() == by_hand for file in measured)
    assert (tmp_path / "here" / "marble" / "report.html").is_file()
    assert json.loads((tmp_path / "here" / "marble" / "fit.json").read_text())["channels"]
