"""How Sphinx builds the documentation (make docs).

Sphinx, as it reads numpydoc and C declarations itself and its search works without a server.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

HERE = Path(__file__).resolve().parent
BUILD = HERE.parent / "build" / "docs"
sys.path.insert(0, str(HERE))

import generate  # noqa: E402


def name_headers_by_path(folder: Path) -> None:
    """Names each header in Doxygen's index by its path, as two folders have a ``servo.h``."""
    index = ElementTree.parse(folder / "index.xml")
    for compound in index.iterfind("compound[@kind='file']"):
        described = ElementTree.parse(folder / f"{compound.get('refid')}.xml")
        location, name = described.find("compounddef/location"), compound.find("name")
        assert location is not None and name is not None, "Doxygen writes both"
        name.text = location.get("file")
    index.write(folder / "index.xml", encoding="UTF-8", xml_declaration=True)


project = "tailbeat"
copyright = "the tailbeat authors"
extensions = [
    "breathe",
    "mathml",
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = ["_doxygen"]
nitpicky = False  # types of the Python API come from packages that are not documented here

html_theme = "furo"
html_title = "tailbeat"
html_static_path = ["_static"]
html_css_files = ["tailbeat.css"]
html_show_copyright = False

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # make test executes the notebook; the page shows what is stored in it
copybutton_exclude = ".linenos, .gp, .go"

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
napoleon_use_ivar = True

breathe_projects = {"tailbeat": str(BUILD / "doxygen" / "xml")}
breathe_default_project = "tailbeat"
breathe_domain_by_extension = {"h": "c"}

html_math_renderer = "mathml"

BUILD.mkdir(parents=True, exist_ok=True)
subprocess.run(["doxygen", str(HERE / "Doxyfile")], cwd=HERE.parent, check=True)
name_headers_by_path(BUILD / "doxygen" / "xml")
generate.write_pages()
