"""The documents as a site: built without a warning, whole, and fit for a narrow screen."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import chromium, show

import bssrdf

ROOT = Path(__file__).resolve().parents[1]
SPHINX = ["-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("sphinx", reason="Sphinx is not installed: pip install 'bssrdf[docs]'")
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run([sys.executable, *SPHINX, ROOT / "docs", out], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with chromium() as one:
        yield one


def test_every_page_is_on_the_site(site: Path) -> None:
    pages = [page.relative_to(ROOT / "docs") for page in (ROOT / "docs").rglob("*.md")]
    assert [page for page in pages if not (site / page.with_suffix(".html")).exists()] == []


def test_the_python_page_has_every_public_name(site: Path) -> None:
    page = (site / "api.html").read_text(encoding="utf-8")
    names = [name for name in dir(bssrdf) if not name.startswith("_")]
    assert [name for name in names if f'id="bssrdf.{name}"' not in page] == []


@pytest.mark.parametrize("width", [375, 1400])
def test_no_page_is_wider_than_the_screen(site: Path, driver: Any, width: int) -> None:
    for page in sorted(site.glob("*.html")):
        show(driver, page, width=width)
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width, page.name
        faults = [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
        assert faults == [], page.name
