"""The legend of a picture: which colour means what."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from moflock_mj.visualization.colours import Legend, LegendEntry

DARK = (14, 17, 22, 150)
"""Ground of words in a picture, RGBA; it lets a little through."""

DIM = (200, 209, 220)
"""Words that need not be read first, RGB."""

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont
"""What Pillow's own font is: scalable where Pillow was built with FreeType."""

_SMALL, _LINE, _BAR = 0.8, 1.3, 6.0
"""Size of the letters, distance of the lines, length of a scale; all in the size of the picture's letters."""


def draw_legend(legend: Legend, unit: float) -> Image.Image:
    """A legend, RGBA.

    Args:
        legend: its entries.
        unit: size of the picture's letters, pixels.
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
    """Where an entry's label begins, pixels from the left."""
    if not len(entry.bounds):
        return 1.8 * unit
    return (_BAR + 1.9) * unit + sum(font.getlength(f"{bound:g}") for bound in entry.bounds)


def _draw_scale(draw: ImageDraw.ImageDraw, entry: LegendEntry, top: float, font: Font, unit: float) -> None:
    """A bar of a scale's colours between its two ends."""
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
