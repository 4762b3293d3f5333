# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Add titles, legends and axis labels to figures, and save figures to files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
import warnings

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import EngFormatter
import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import shortened

#: The number of characters that fit into the title of a picture even if all characters are wide.
_TITLE = 50


def literal(title: str) -> str:
    """Shorten a title to fit into the picture, and replace bytes that are not text."""
    return shortened(title.encode(errors='replace').decode(), _TITLE)


def save(figure: Figure, path: str | Path, dpi: int) -> None:
    """
    Save a figure to a PNG file.

    Names are drawn literally, so a $ does not start a formula. Characters that are missing from
    the font are drawn as boxes.
    """
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_text():  # ticks get their text later, often with powers of ten
            text.set_parse_math(False)
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Glyph|Matplotlib currently does not support')
        FigureCanvasAgg(figure).print_figure(path, dpi=dpi, format='png')


def legend(panel: Axes, **options: Any) -> None:
    """Draw a legend to the right of a panel."""
    panel.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, **options)


def label(axis: Axis, text: str, unit: str, values: Floats) -> None:
    """Label an axis; if all values are small, use a unit with a prefix, such as mrad/s."""
    largest = float(np.abs(values).max())
    exponent = min(3 * math.floor(math.log10(largest) / 3.0), 0) if largest else 0
    exponent = max(exponent, min(EngFormatter.ENG_PREFIXES))
    if exponent:
        axis.set_major_formatter(lambda value, _: _scaled(value, 10.0 ** exponent))
    axis.set_label_text(f'{text} ({EngFormatter.ENG_PREFIXES[exponent]}{unit})')


def _scaled(value: float, scale: float) -> str:
    return f'{round(value / scale, 9) + 0.0:g}'.replace('-', '−')  # + 0.0 turns -0 into 0
