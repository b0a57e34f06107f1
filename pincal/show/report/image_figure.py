"""The figure of a report that shows what cameras saw, and how far that is off."""

from __future__ import annotations

from matplotlib.figure import Figure

from pincal.show.pictures.files import on_page
from pincal.show.pictures.image_charts import over_images, seen_in
from pincal.show.report.findings import Findings
from pincal.show.style import PAGE
from pincal.words import plots as words


@on_page("figure-images")
def images_figure(found: Findings) -> tuple[Figure, str] | None:
    """Return residuals over the images of cameras; None if none measured."""
    if not (every := seen_in(found.result)):
        return None
    drawn = Figure(
        figsize=(PAGE.width, PAGE.width / (0.6 + min(len(every), 2))), layout="compressed"
    )
    over_images(drawn.subplots(), found.result)
    return drawn, words.IMAGES
