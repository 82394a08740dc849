"""Settings of the documentation site: ``sphinx-build -W --keep-going docs docs/_build``."""

import os
import shutil
import sys
from importlib.resources import files
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE.parent)]  # the examples import scenes from the checkout

from sphinx_gallery.sorting import ExplicitOrder

import liaam

project = "liaam"
author = "The liaam developers"
copyright = "The liaam developers"
version = release = liaam.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "sphinx_design",
    "command_line",
    "link_check",
    "mathml",
    "repository_pages",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "_extensions", "figures", "gallery/*.ipynb", "gallery/*.py", "gallery/backreferences"]
suppress_warnings = ["config.cache"]

# Markdown
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 4
myst_dmath_double_inline = True
html_math_renderer = "mathml"

# Files of the repository that are pages of the site
repository_pages = {
    "project/contributing": "CONTRIBUTING.md",
    "project/security": "SECURITY.md",
    "project/changes": "CHANGELOG.md",
    "project/benchmarks": "benchmarks/README.md",
    "project/fuzzing": "fuzz/README.md",
    "project/experiments": "experiments/README.md",
    **{
        f"project/notes/{path.stem}": f"experiments/notes/{path.name}"
        for path in HERE.parent.glob("experiments/notes/*.md")
    },
}

# API reference
shutil.rmtree(HERE / "reference/generated", ignore_errors=True)  # pages of names that are gone
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# Gallery
ORDER = [
    "plot_first_model.py",
    "plot_choose_method.py",
    "plot_hard_light.py",
    "plot_uncertainty.py",
    "plot_video.py",
    "plot_relighting.py",
    "plot_batch.py",
    "plot_specimens.py",
    "plot_other_objects.py",
    "plot_calibration.py",
    "plot_invariant.py",
    "plot_registration.py",
    "plot_occlusion.py",
    "plot_own_features.py",
    "plot_label_faults.py",
]
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "within_subsection_order": ExplicitOrder(ORDER),
    "doc_module": ("liaam",),
    "backreferences_dir": "gallery/backreferences",
    "image_srcset": ["2x"],
    "download_all_examples": False,
    "parallel": True,  # as many as sphinx-build -j says
    "show_memory": False,
    "show_signature": False,
    "capture_repr": (),
    "min_reported_time": 1000,
    "write_computation_times": False,
    "remove_config_comments": True,
}

# Pages
FONTS = files("ziamath") / "fonts"  # STIX Two Math
html_theme = "pydata_sphinx_theme"
html_title = "liaam"
html_static_path = ["_static", str(FONTS)]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "header_links_before_dropdown": 6,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": []}
