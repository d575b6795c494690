"""The file of a figure depends on nothing else that was drawn."""

import subprocess
import sys

SMALL = """
import hashlib
from biaxbayes.figures.style import blank_figure, figure_bytes, print_style

def drawn(text):
    with print_style():
        figure = blank_figure(50.0, 25.0)
        figure.subplots().text(0.1, 0.5, text)
    return [hashlib.sha256(figure_bytes(figure, kind)).hexdigest() for kind in ("pdf", "png")]
"""


def test_a_file_does_not_tell_what_was_drawn_before_it():
    here: dict = {}
    exec(SMALL, here)
    texts = [r"$\kappa$ of the media, identified", r"$C_1$, $\kappa$ and \N{SNOWMAN} ∑", "x (kPa)"]
    for text in texts:
        here["drawn"](text)
    again = [here["drawn"](text) for text in reversed(texts)]
    for text, files in zip(reversed(texts), again, strict=True):
        code = f"{SMALL}\nprint(*drawn({text!r}))"
        fresh = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
        assert fresh.stdout.decode().split() == files
