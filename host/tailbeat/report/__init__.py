"""One picture and one self-contained page about a series of trials."""

from tailbeat.report.data import Series, Swim
from tailbeat.report.html import write_html
from tailbeat.report.png import render_png

__all__ = ["Series", "Swim", "render_png", "write_html"]
