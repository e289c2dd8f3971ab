"""The house is in order: packaging lists, pins, no global setting of JAX, documents that say what the code says."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_args

import pytest

from bssrdf.session.flags import Flag, Stage

ROOT = Path(__file__).resolve().parents[1]


def pyproject() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def tracked_modules() -> list[Path]:
    """Python files of the package that git knows, relative to the root."""
    if not (ROOT / ".git").exists():
        pytest.skip("this is no git checkout")
    done = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [Path(line) for line in done.stdout.splitlines() if not line.startswith(("tests/", "docs/"))]


def package_of(module: Path) -> str:
    return ".".join(["bssrdf", *module.parent.parts])


def test_every_module_lies_in_a_package_that_is_installed_and_type_checked() -> None:
    config = pyproject()["tool"]
    installed = set(config["setuptools"]["packages"])
    assert {package_of(module) for module in tracked_modules()} == installed
    checked = {*config["mypy"]["packages"], "bssrdf"}
    assert {".".join(name.split(".")[:2]) for name in installed} == checked
    at_root = {f"bssrdf.{module.stem}" for module in tracked_modules() if module.parent == Path()}
    assert at_root - {"bssrdf.__init__"} | {"bssrdf"} == set(config["mypy"]["modules"])


def test_every_layer_is_held_by_a_contract() -> None:
    config = pyproject()["tool"]
    layers = {name for line in config["importlinter"]["contracts"][0]["layers"] for name in line.split(" | ")}
    assert {".".join(name.split(".")[:2]) for name in config["setuptools"]["packages"]} - {"bssrdf"} <= layers


def test_pins_are_versions_and_nothing_else() -> None:
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        assert re.fullmatch(r"[\w.-]+==[\w.]+( ; [\w.]+ [<>=!]=? '[\w.]+'( (and|or) .*)?)?", line), line


def test_importing_the_package_changes_no_setting_of_jax() -> None:
    code = """
import importlib, sys, jax
before = dict(jax.config.values)
for name in sys.argv[1:]:
    importlib.import_module(name)
assert dict(jax.config.values) == before
"""
    names = [
        ".".join([package_of(module), module.stem]).removesuffix(".__init__")
        for module in tracked_modules()
        if module.name != "__main__.py"
    ]
    done = subprocess.run([sys.executable, "-c", code, *names], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_every_flag_is_raised_by_the_stage_that_it_names() -> None:
    for stage in get_args(Stage):
        files = [*(ROOT / stage).glob("*.py"), *(ROOT / "batch").glob(f"{stage}*.py")]
        code = "".join(file.read_text(encoding="utf-8") for file in files)
        raised = {Flag[name] for name in re.findall(r"\bFlag\.([A-Z_]+)\b", code)}
        assert raised == {flag for flag in Flag if stage in flag.raised_by}


def test_no_name_behind_a_door_is_that_of_a_module() -> None:
    """Importing the module would put it in the place of the name."""
    for init in (module for module in tracked_modules() if module.name == "__init__.py"):
        block = re.search(r"if TYPE_CHECKING:\n((?:    .*\n)+)", (ROOT / init).read_text(encoding="utf-8"))
        names = re.findall(r" as (\w+)$", block[1], re.MULTILINE) if block else []
        beside = {path.stem for path in (ROOT / init).parent.iterdir()}
        assert not beside & set(names), init


def test_only_the_simulated_bench_needs_posix_to_be_imported() -> None:
    """On Windows measuring and fitting import: such modules stand inside functions, or where ImportError is caught."""
    posix = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}
    for module in tracked_modules():
        if module.parts[:2] == ("rig", "sim"):
            continue
        for node in ast.parse((ROOT / module).read_text(encoding="utf-8")).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            assert not posix & {name.split(".")[0] for name in names}, module
