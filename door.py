"""The door of a folder: the public names that its `__init__` imports for type checkers, each imported when first used.

if TYPE_CHECKING:
    from bssrdf.transport.dipole import Medium as Medium
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def door(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of the package whose `__init__` is `file`."""
    homes = _imported_for_checkers(ast.parse(Path(file).read_text(encoding="utf-8")))

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, original = homes[name]
        value = getattr(importlib.import_module(module), original)
        setattr(sys.modules[package], name, value)
        return value

    return get, lambda: sorted({*vars(sys.modules[package]), *homes}), sorted(homes)


def _imported_for_checkers(tree: ast.Module) -> dict[str, tuple[str, str]]:
    """By public name the module it lives in and its name there."""
    blocks = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: (str(node.module), alias.name) for node in imports for alias in node.names}
