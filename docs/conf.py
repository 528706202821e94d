"""Settings of the documentation: ``make docs``."""

from __future__ import annotations

import logging
import os
import sys
from importlib.util import find_spec
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "_ext")]

import torch_pmil  # noqa: E402

project = "torch_pmil"
author = "the torch_pmil authors"
copyright = author
release = version = torch_pmil.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "api_pages",
    "code_links",
    "docstrings",
    "equations",
    "kernels",
    "notebooks",
    "results",
    "settings_table",
    "whole_links",
]
exclude_patterns = ["_build", "_ext", "figures", "**/.ipynb_checkpoints"]
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", rf"({name})\b.*")
    for name in (
        # their objects are not ours
        "torch|tensordict|torchrl|gpytorch|numpy|scipy|matplotlib|mujoco|gymnasium|hydra|omegaconf",
        "examples|numba|abc|argparse|collections|enum|functools|http|os|pathlib|types|typing",
        # by the names that annotations and docstrings have for them
        "nn|np|Path|Tensor|TensorDictModule|EnvBase|CheckpointError|Guard",
        "Array[1-5]?|Address|TypeAliasForwardRef",
        # type variables and a private class
        r"reproduction\.runge_kutta\.State",
        r"torch_pmil\.(control\.state_policy\.State|tasks\.own_parts\.T|demonstrations\.turns\.Shown|model\.compiled\.building\.Function|search\.trajectory_loss\.TrajectoryLoss\._AcceptedKeys)",
    )
]

autodoc_default_options = {
    "members": True,
    "member-order": "bysource",
    "show-inheritance": True,
    "ignore-module-all": True,  # what a room's __init__ imports is listed at its module
}
viewcode_follow_imported_members = False  # the page of a source is that of its module
autodoc_inherit_docstrings = False
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ("Array", *(f"Array{d}" for d in range(1, 6)))}
python_use_unqualified_type_names = True
add_module_names = False
maximum_signature_line_length = 100
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False

myst_enable_extensions = ["dollarmath", "amsmath", "tasklist"]
myst_heading_anchors = 4
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 1800  # s, for a cell
nb_merge_streams = True

# kernels of the notebooks: no settings of the user's own, and no warning that they speak TCP on
# this machine
ipython = DOCS / "_build" / "ipython"
(ipython / "profile_default").mkdir(parents=True, exist_ok=True)
(ipython / "profile_default" / "ipython_kernel_config.py").write_text(
    'c.IPKernelApp.log_level = "ERROR"\n'
)
os.environ["IPYTHONDIR"] = str(ipython)
# a line for each notebook else, and one where PyOpenGL has no compiled part
for name in ("traitlets", "OpenGL"):
    logging.getLogger(name).setLevel(logging.WARNING)

html_theme = "furo"
# MathJax comes along, as one file, so that pages show equations without a network
mathjax = Path(find_spec("sphinx-mathjax-offline").origin).with_name("static") / "mathjax"
mathjax_path = "tex-svg.js"
html_static_path = ["_static", str(mathjax / mathjax_path)]
html_css_files = ["pages.css"]
html_title = f"torch_pmil {release}"
