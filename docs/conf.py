"""The documentation as a site: `make site` builds it into runs/site from the repository's own pages."""

from dlwpredict import __version__

project, author, release = "dlwpredict", "the dlwpredict developers", __version__
copyright = author

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "*.md",
    "configs/README.md",
    "sample_data/README.md",
    "sample_data/proof/README.md",
    "tests/README.md",
    "tests/press/README.md",
]
exclude_patterns = ["CHANGELOG.md", "runs/**", ".venv/**"]
myst_heading_anchors = 3
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
html_theme = "furo"
html_title = f"dlwpredict {release}"
html_copy_source = False
