"""The documentation: `sphinx-build -j auto -W docs docs/_build`, without a network.

Pages are Markdown (MyST); those of `tutorials/` and `how_to/` that name a kernel are
executed and their results cached. What can be told from the source or from recorded
results is written by the scripts of `making/` before Sphinx reads the first page.
"""

import importlib.metadata
import os
import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "making"), str(DOCS.parent / "tests")]

from jupyter_cache.cache.main import JupyterCacheBase  # noqa: E402
from quick import compile_quickly  # noqa: E402 # pyright: ignore[reportMissingImports]

# Pages give commands too: those of this Python, on the files that the page has made.
os.environ["PATH"] = os.pathsep.join(
    [str(Path(sys.executable).parent), os.environ["PATH"]]
)
os.environ.pop("JAXNARX_DATA", None)
# What one page has compiled serves the next one.
compile_quickly(str(DOCS / "_build" / "compiled"))

project = "jaxnarx"
copyright = "the jaxnarx authors, Apache-2.0"
version = release = importlib.metadata.version("jaxnarx")

extensions = ["myst_nb", "streams", "mathml", "pages"]
# The formulas are MathML, made at build by docutils (see making/mathml.py): no script
# to vendor or to fetch, and readable without one.
html_math_renderer = "mathml"

exclude_patterns = [
    *("_build", ".jupyter_cache", "**/jupyter_execute", "jupyter_execute"),
    # Of made files those with an underscore are parts of other pages.
    *("making", "**/made/_*", "**/.ipynb_checkpoints"),
]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
# A Python signature of a page belongs to the package it names by itself.
add_module_names = False
python_maximum_signature_line_length = 88
toc_object_entries = False
# Two classes of one name are meant, see tests/test_architecture.py: an annotation that
# names one of them in a signature links to the first.
suppress_warnings = ["ref.python"]

nb_execution_mode = "cache"
nb_execution_cache_path = str(DOCS / ".jupyter_cache")
nb_execution_timeout = 180
nb_execution_raise_on_error = True
nb_execution_show_tb = True
# Tutorials leave their files in a folder of their own, not beside these pages.
nb_execution_in_temp = True
nb_merge_streams = True
# After every page the cache deletes what is too much, which is a page that another
# process is about to write where it came between two of its queries. Ours has room.
JupyterCacheBase.truncate_caches = lambda self: None

html_theme = "furo"
html_title = "jaxnarx"
html_static_path = ["_static"]
# At the root as they are; assistants.md holds the second as a page.
html_extra_path = ["llms.txt", "SKILL.md"]
html_css_files = ["jaxnarx.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
