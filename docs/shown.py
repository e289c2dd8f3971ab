"""Run the commands that the tutorial pages show, and write what they print into the pages anew: `make docs-shown`.

A block marked `sh` is run by bash as it stands, in a folder that holds `docs` and `tests` as a clone does; the block
marked `text` behind it, if there is one, is what it printed. A `python` block is the file that is named before it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "docs" / name for name in ("tutorial.md", "curves.md")]
IMAGES = ROOT / "docs" / "images"
_SCRIPT = re.compile(r"`(\w+\.py)`[^`]*\n```python\n(.*?)```", re.DOTALL)
_SHOWN = re.compile(r"```sh\n(?P<commands>.*?)```\n(?:\n?```text\n(?P<printed>.*?)```\n)?", re.DOTALL)


def as_in_a_clone(folder: Path, text: str) -> None:
    """Links to docs and tests, and the scripts of the page, in an empty folder."""
    for name in ("docs", "tests"):
        (folder / name).symlink_to(ROOT / name)
    for name, script in _SCRIPT.findall(text):
        (folder / name).write_text(script, encoding="utf-8")


def shown(text: str, folder: Path) -> Iterator[tuple[re.Match[str], str]]:
    """Each block of commands of a page, and what it prints when it is run."""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    places = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    modules = os.pathsep.join(str(Path(place).resolve()) for place in places if place)
    environment = {**os.environ, "PATH": programs, "PYTHONPATH": modules, "COLUMNS": "80"}
    for block in _SHOWN.finditer(text):
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block["commands"]],
            cwd=folder, env=environment, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"exit code {done.returncode} of\n{block['commands']}{done.stdout}")
        yield block, done.stdout


def written_anew(text: str) -> str:
    """The page with what its commands print now."""
    pieces, end = [], 0
    with tempfile.TemporaryDirectory() as name:
        as_in_a_clone(Path(name), text)
        for block, printed in shown(text, Path(name)):
            if block["printed"] is not None:
                pieces += [text[end : block.start("printed")], printed]
                end = block.end("printed")
        keep_pictures(Path(name) / "marble")
    return "".join([*pieces, text[end:]])


def keep_pictures(session: Path) -> None:
    """What `measure` drew, and the top of the report's page where Chromium is installed."""
    if not (session / "report.html").is_file():
        return
    shutil.copyfile(session / "measured" / "slice.png", IMAGES / "tutorial_slice.png")
    as_webp(session / "measured" / "scene.png", IMAGES / "tutorial_scene.webp")
    if shutil.which("chromium") and shutil.which("chromedriver"):
        sys.path.insert(0, str(ROOT / "tests"))
        from browser import chromium, show

        with chromium() as driver:
            show(driver, session / "report.html", width=1000)
            driver.save_screenshot(str(session / "report.png"))
        as_webp(session / "report.png", IMAGES / "tutorial_report.webp")


def as_webp(source: Path, file: Path) -> None:
    """A tenth of the room that a photograph takes as PNG."""
    cv2.imwrite(str(file), cv2.imread(str(source)), [cv2.IMWRITE_WEBP_QUALITY, 85])


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(written_anew(page.read_text(encoding="utf-8")), encoding="utf-8")
