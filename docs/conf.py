"""Configuration of the documentation: Markdown through MyST, the interface from its docstrings, the Furo theme."""

from neurorobo import __version__

project = "neurorobo"
author = "the neurorobo developers"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx_copybutton"]
exclude_patterns = ["schema"]
templates_path = ["_templates"]
default_role = "code"  # docstrings write names in single backticks

myst_enable_extensions = ["deflist", "fieldlist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"

html_theme = "furo"
html_title = "neurorobo"
copybutton_prompt_text = "$ "
