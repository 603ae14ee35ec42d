"""A matplotlib figure as a picture in a page."""

import base64
import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave

DPI = 110


def picture(figure: Figure) -> str:
    """HTML of a figure, drawn into the page itself."""
    figure.set_dpi(DPI)
    canvas, buffer = FigureCanvasAgg(figure), io.BytesIO()
    canvas.draw()  # laid out and drawn once; savefig would do both twice
    imsave(buffer, canvas.buffer_rgba(), format="png")
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'
