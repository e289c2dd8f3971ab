"""The stages of a chunk of inputs, one after another, each input by itself but for the fits, which go together.

Nothing is written into an input. The folder of its results becomes a session without frames: session.toml, frames.csv,
measured/, fit.json and report.html, so that every other command takes it too.
"""

from __future__ import annotations

import errno
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bssrdf.batch.fit_steps import fit_files
from bssrdf.batch.inputs import STAGES, BatchInput, Stage, filesystem
from bssrdf.batch.state import InputOutcome, StageKeys
from bssrdf.errors import BssrdfError, InputError
from bssrdf.fit import FitOptions
from bssrdf.session import fit_to_dict, make_folder, read_fit

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


class CannotGoOnError(BssrdfError):
    """Nothing can be written any more: what is finished stays, the rest is for another run."""

    exit_code = 3


@dataclass(frozen=True)
class StageOptions:
    """What the caller asked of the stages."""

    fit: FitOptions = field(default_factory=FitOptions)
    keys: Mapping[str, Any] = field(default_factory=dict)
    """Keys of slice.csv that win over the files'."""
    settings: str | None = None
    """A session.toml for sessions made of frames."""


@dataclass
class _Work:
    """An input on its way."""

    item: BatchInput
    folder: Path
    known: InputOutcome | None
    keys: StageKeys
    outcome: InputOutcome
    brought: str | None = None
    """Where the slice lies that was not measured here."""

    def is_done(self, stage: Stage) -> bool:
        """Whether an earlier run did this stage on the same, and its result is still there."""
        return (
            self.known is not None
            and (self.known.failed is None or STAGES.index(self.known.failed[0]) > STAGES.index(stage))
            and self.known.keys.get(stage) == self.keys[stage]
            and result_of(self.folder.parent, self.item, stage).exists()
        )


_RESULT: dict[Stage, str] = {
    "ingest": "session/session.toml",
    "measure": "measured/slice.csv",
    "fit": "fit.json",
    "report": "report.html",
}


def result_of(out: Path, item: BatchInput, stage: Stage) -> Path:
    """The file that a stage writes last."""
    return out / "fits" / f"{item.name}.parquet" if item.rows else out / item.name / _RESULT[stage]


def run_stages(
    inputs: Sequence[tuple[BatchInput, InputOutcome | None, StageKeys]],
    out: Path,
    stages: Sequence[Stage],
    options: StageOptions,
    *,
    begun: Callable[[str], None] = lambda name: None,
) -> list[InputOutcome]:
    """Run the stages for some inputs, each with what an earlier run made of it; what failed says so in its outcome.

    `begun` is told each input before work on it begins. Raises CannotGoOnError where nothing can be written.
    """
    if inputs[0][0].rows:
        return [_bulk(item, keys, out, options) for item, _, keys in inputs]
    works = [
        _Work(item, out / item.name, known, keys, InputOutcome(item.name, item.path, dict(keys)))
        for item, known, keys in inputs
    ]
    first = next((stage for stage in stages if stage != "ingest"), stages[0])
    for work in works:
        begun(work.item.name)
        _attempt(work, first, partial(_prepare, work, stages, options))
    if "fit" in stages:
        begun("")
        _fit([work for work in works if work.outcome.failed is None], options)
    for work in works:
        if "report" in stages and work.outcome.failed is None and not work.is_done("report"):
            begun(work.item.name)
            _attempt(work, "report", partial(_report, work))
    return [work.outcome for work in works]


def _bulk(item: BatchInput, keys: StageKeys, out: Path, options: StageOptions) -> InputOutcome:
    """Rows of a Parquet file into a file of their fits."""
    from bssrdf.batch.fit_bulk import fit_parquet

    outcome = InputOutcome(item.name, item.path, dict(keys))
    target = result_of(out, item, "fit")
    try:
        make_folder(target.parent)
        counts = fit_parquet(Path(item.file), target, options.fit, options.keys, rows=item.rows)
        outcome.statuses, outcome.lost = dict(sorted(counts.statuses.items())), counts.failures
    except Exception as error:  # our own bug costs some rows, not the batch
        outcome.failed = _failure("fit", error, item.path, target)
    return outcome


def _attempt(work: _Work, stage: Stage, call: Callable[[], None]) -> None:
    try:
        call()
    except Exception as error:  # our own bug costs one session, not the batch
        _failed(work, stage, error)


def _failed(work: _Work, stage: Stage, error: Exception) -> None:
    stage, code, line = _failure(stage, error, work.item.path, work.folder)
    if work.brought is not None:  # the copy is ours, the file that has to be mended is not
        line = line.replace(str(work.folder / "measured" / "slice.csv"), work.brought)
    line = re.sub(rf"{re.escape(str(work.folder))}/([^/:]+\.toml)", lambda toml: f"{work.item.path}/{toml[1]}", line)
    work.outcome.failed = (stage, code, line)


def _failure(stage: Stage, error: Exception, path: str, target: Path) -> tuple[Stage, int, str]:
    """Stage, exit code and line; CannotGoOnError where the disk is full."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _DISK:
            raise CannotGoOnError(f"{target}: {cause.strerror}; make room, and run the same command again")
        cause = cause.__cause__
    ours = isinstance(error, BssrdfError)
    line = str(error) if ours else f"{path}: an internal error: {error!r}"
    return stage, error.exit_code if isinstance(error, BssrdfError) else 1, " ".join(line.split())


def _prepare(work: _Work, stages: Sequence[Stage], options: StageOptions) -> None:
    """The folder of results with a slice in it, measured now or brought along."""
    make_folder(work.folder)
    needs_session = "measure" in stages and not work.is_done("measure")
    if not needs_session and all(work.is_done(stage) for stage in stages if stage in ("measure", "fit")):
        return
    with _at_hand(work.item.path) as source:
        try:
            session = _ingested(work, source, options) if "ingest" in stages and source.is_dir() else source
            if "measure" not in stages:
                work.brought = work.item.path + ("/measured/slice.csv" if source.is_dir() else "")
            _bring(session, work.folder, with_slice="measure" not in stages)
            if needs_session:
                _measure(session, work.folder)
        except InputError as error:
            raise InputError(str(error).replace(str(source), work.item.path)) from error


@contextmanager
def _at_hand(path: str) -> Iterator[Path]:
    """The input as a path of this machine; one that lies elsewhere is fetched for as long as the block lasts."""
    if "://" not in path:
        yield Path(path)
        return
    system, root = filesystem(path)
    with tempfile.TemporaryDirectory(prefix="bssrdf-") as folder:
        try:
            system.get(root.rstrip("/") + "/", f"{folder}/session/", recursive=True)
        except Exception as error:  # each file system has errors of its own
            raise InputError(f"{path}: cannot be fetched ({error}); check address and credentials") from error
        yield Path(folder) / "session"


def _ingested(work: _Work, source: Path, options: StageOptions) -> Path:
    """The session of a folder of frames; one that is a session already is itself."""
    from bssrdf.session import ingest_folder

    if (source / "frames.csv").is_file():
        return source
    session = work.folder / "session"
    if work.is_done("ingest"):
        return session
    settings = Path(options.settings) if options.settings else source / "session.toml"
    if not settings.is_file():
        raise InputError(f"{source}: has no session.toml that says what was measured; put one there or give --settings")
    ingest_folder(source, session)
    shutil.copyfile(settings, session / "session.toml")
    return session


def _bring(session: Path, folder: Path, *, with_slice: bool) -> None:
    """Copy what describes the session, and its slice where none is measured now."""
    if session.is_file():
        (folder / "measured").mkdir(exist_ok=True)
        shutil.copyfile(session, folder / "measured" / "slice.csv")
        return
    for file in (session / "frames.csv", *session.glob("*.toml")):
        if file.is_file():
            shutil.copyfile(file, folder / file.name)
    if with_slice:
        source = session / "measured" / "slice.csv"
        if not source.is_file():
            raise InputError(f"{session}: has no measured/slice.csv; add measure to --stages")
        (folder / "measured").mkdir(exist_ok=True)
        shutil.copyfile(source, folder / "measured" / "slice.csv")


def _measure(session: Path, folder: Path) -> None:
    from bssrdf.measure import measure_session
    from bssrdf.session import read_session

    measure_session(read_session(session), out=folder / "measured")


def _fit(works: Sequence[_Work], options: StageOptions) -> None:
    todo = [work for work in works if not work.is_done("fit")]
    try:
        fits = fit_files([work.folder for work in todo], options.fit, options.keys)
    except Exception as error:
        fits = [error if isinstance(error, BssrdfError) else InputError(repr(error))] * len(todo)
    for work, fit in zip(todo, fits, strict=True):
        if isinstance(fit, BssrdfError):
            _failed(work, "fit", fit)
    for work in works:
        if work.outcome.failed is None:
            document = fit_to_dict(read_fit(work.folder / "fit.json"))
            work.outcome.channels = document["channels"]
            work.outcome.material = document["material"]


def _report(work: _Work) -> None:
    from bssrdf.report import write_report

    is_session = (work.folder / "session.toml").is_file()
    write_report(work.folder if is_session else work.folder / "fit.json", work.folder / "report.html", force=True)
