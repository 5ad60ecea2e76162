"""Legend of a video frame: colours and their meaning."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from moflock_mj.visualization.colours import Legend, LegendEntry

DARK = (14, 17, 22, 150)
"""Translucent background of text, RGBA."""

DIM = (200, 209, 220)
"""Colour of secondary text, RGB."""

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont
"""Font of Pillow, which is scalable if Pillow was built with FreeType."""

_SMALL, _LINE, _BAR = 0.8, 1.3, 6.0
"""Font size, line spacing, and length of a scale, in units of the caption's font size."""


def draw_legend(legend: Legend, unit: float) -> Image.Image:
    """Draw a legend, RGBA.

    Args:
        legend: entries of the legend.
        unit: font size of the captions, pixels.
    """
    font = ImageFont.load_default(_SMALL * unit)
    lettering = ImageDraw.Draw(Image.new("RGBA", (1, 1)))
    places = [_label_place(entry, font, unit) for entry in legend]
    ends = [place + lettering.textlength(entry.label, font) for place, entry in zip(places, legend, strict=True)]
    size = round(max(ends) + 0.5 * unit), round(_LINE * unit * len(legend) + 0.4 * unit)
    panel = Image.new("RGBA", size, DARK)
    draw = ImageDraw.Draw(panel)
    for number, (entry, place) in enumerate(zip(legend, places, strict=True)):
        top = 0.3 * unit + _LINE * unit * number
        if len(entry.bounds):
            _draw_scale(draw, entry, top, font, unit)
        else:
            draw.ellipse((0.5 * unit, top + 0.1 * unit, 1.3 * unit, top + 0.9 * unit), fill=_opaque(entry.rgb[0]))
        draw.text((place, top), entry.label, fill=DIM, font=font)
    return panel


def _label_place(entry: LegendEntry, font: Font, unit: float) -> float:
    """Left edge of an entry's label, pixels."""
    if not len(entry.bounds):
        return 1.8 * unit
    return (_BAR + 1.9) * unit + sum(font.getlength(f"{bound:g}") for bound in entry.bounds)


def _draw_scale(draw: ImageDraw.ImageDraw, entry: LegendEntry, top: float, font: Font, unit: float) -> None:
    """Draw the colour bar of a scale between its two bounds."""
    low, high = (f"{bound:g}" for bound in entry.bounds)
    left, length = 0.9 * unit + font.getlength(low), int(_BAR * unit)
    colours = np.array(entry.rgb, float)
    shares = np.linspace(0, len(colours) - 1, length)
    channels = [np.interp(shares, range(len(colours)), channel) for channel in colours.T]
    for x, rgb in enumerate(np.stack(channels, axis=-1)):
        draw.line((left + x, top + 0.15 * unit, left + x, top + 0.85 * unit), fill=_opaque(rgb))
    draw.text((0.5 * unit, top), low, fill=DIM, font=font)
    draw.text((left + length + 0.4 * unit, top), high, fill=DIM, font=font)


def _opaque(rgb: object) -> tuple[int, int, int, int]:
    red, green, blue = (int(channel) for channel in np.asarray(rgb))
    return red, green, blue, 255
