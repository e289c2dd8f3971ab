"""The house is in order: packaging lists, pins, no global setting of JAX, documents that say what the code says."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from bssrdf.fit import flags as fit_flags
from bssrdf.measure import flags as measure_flags

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


@pytest.mark.parametrize(("command", "meaning"), [("measure", measure_flags.MEANING), ("fit", fit_flags.MEANING)])
def test_flags_are_listed_with_their_meaning(command: str, meaning: dict[str, str]) -> None:
    page = (ROOT / "docs" / "flags.md").read_text(encoding="utf-8")
    section = page.split(f"## Raised by `bssrdf {command}`")[1].split("##")[0]
    listed = re.findall(r"^\| `(\w+)` \| (.+) \|$", section, re.MULTILINE)
    assert listed == sorted(meaning.items())


def test_every_flag_that_measuring_raises_has_a_meaning() -> None:
    """Flags are the keys of a dict `raised`, or lone words in a list or an `append`."""
    names: set[str] = set()
    for file in (ROOT / "measure").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match node:
                case ast.Assign(targets=[ast.Name(id="raised")], value=ast.Dict(keys=keys)):
                    names |= {key.value for key in keys if isinstance(key, ast.Constant)}
                case ast.Call(func=ast.Attribute(attr="append"), args=[ast.Constant(value=str(name))]):
                    names.add(name)
                case ast.IfExp(body=ast.List(elts=[ast.Constant(value=str(name))])):
                    names.add(name)
                case ast.Return(value=ast.Tuple(elts=[_, ast.List(elts=[ast.Constant(value=str(name))])])):
                    names.add(name)
    assert names == set(measure_flags.MEANING)
