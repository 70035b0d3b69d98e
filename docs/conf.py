"""The documentation as a site: `make site` builds it into runs/site from the repository's own pages."""

import sys
from pathlib import Path

from dlwpredict import __version__

sys.path.append(str(Path(__file__).parent))  # gallery_figures

project, author, release = "dlwpredict", "the dlwpredict developers", __version__
copyright = author

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "sphinx_gallery.gen_gallery"]
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "docs/examples/*.rst",  # made of docs/gallery
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
html_static_path = ["static"]
html_css_files = ["narrow.css"]
html_title = f"dlwpredict {release}"
html_copy_source = False

sphinx_gallery_conf = {
    "examples_dirs": "docs/gallery",
    "gallery_dirs": "docs/examples",
    "filename_pattern": r"\.py$",  # all of them are run, every time
    "run_stale_examples": True,
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("gallery_figures.last_expression", "matplotlib"),
    "write_computation_times": False,
    "show_signature": False,
    "remove_config_comments": True,
    "min_reported_time": 60,
}
