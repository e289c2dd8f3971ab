"""How Sphinx builds these pages: `make docs`."""

from __future__ import annotations

import inspect

import bssrdf
from bssrdf import __version__ as release

for name in dir(bssrdf):  # each is shown by its public name, wherever it is written
    if inspect.isclass(thing := getattr(bssrdf, name)):
        thing.__name__ = thing.__qualname__ = name
        thing.__module__ = "bssrdf"

project = "bssrdf"
author = copyright = "The bssrdf authors"  # noqa: A001  # Sphinx's own name
version = release

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["**.ipynb_checkpoints", "tutorial"]
highlight_language = "none"
myst_enable_extensions = ["tasklist"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 120

autodoc_typehints = "signature"
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
autodoc_class_signature = "separated"  # made by functions, not by hand
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
default_role = "code"  # what docstrings have in single backticks
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = f"bssrdf {release}"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]
