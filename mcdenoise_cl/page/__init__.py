"""One HTML file to compare a noisy frame with its results: it needs no network, and nothing beside it.

page.html, page.css and the scripts are put into that file; the images travel in it as numbers (codec.py, planes.py), of
which the page makes pictures at any exposure.
"""

from .content import Entry
from .write import Page, make_page, write_page

__all__ = ["Entry", "Page", "make_page", "write_page"]
