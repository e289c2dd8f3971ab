"""The notebook of the documents runs from top to bottom, and the API costs no more than the command line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bssrdf

NOTEBOOK = Path(__file__).resolve().parents[1] / "docs" / "notebooks" / "curve.ipynb"


def test_the_notebook_runs_and_finds_the_coefficients(tmp_path: Path) -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert len(notebook.cells) == 8
    client = nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert "Did the fit settle?" in str(notebook.cells[3].outputs[0].data["text/html"])
    assert "image/png" in notebook.cells[5].outputs[0].data
    assert any("did you mean model?" in output.get("text", "") for output in outputs)
    found = bssrdf.read_fit(tmp_path / "phantom.json").channels["mono"]
    low, high = found.sigma_a_interval95_per_mm
    assert low * 0.99 < 0.01 < high * 1.01
    assert found.sigma_sp_per_mm == pytest.approx(1.0, rel=0.02)
    assert "can be trusted" in (tmp_path / "phantom.html").read_text(encoding="utf-8")


@pytest.mark.skipif(shutil.which("env") is None or os.name != "posix", reason="children's CPU time is told by POSIX")
def test_the_first_fit_in_python_costs_no_more_than_the_command(tmp_path: Path) -> None:
    import resource

    r = np.geomspace(0.5, 20, 60)
    rd = 0.1 * np.exp(-0.3 * r) / r**2
    keys = {"eta": 1.4, "g": 0.8, "flux": "entering", "exit": "hemisphere", "total_r": 0.5, "total_r_sd": 0.2}
    file = tmp_path / "slice.csv"
    bssrdf.write_slice(file, bssrdf.Slice.from_arrays(r, rd, rd / 50, **keys))

    def seconds(*words: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *words], check=True, capture_output=True, timeout=120)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    command = ["-m", "bssrdf", "fit", str(file), "--model", "mc"]
    call = ["-c", f"import bssrdf; print(bssrdf.fit_slice({str(file)!r}, model='mc').channels)"]
    seconds(*command)
    assert seconds(*call) < 1.3 * seconds(*command) + 0.1
