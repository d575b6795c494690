"""Colour and line of every method on the page of the paper."""

__all__ = ["COLOUR", "STYLE"]

# Okabe and Ito, with black for what is true
COLOUR = {
    "truth": "#000000",
    "standard": "#D55E00",
    "zeroed": "#E69F00",
    "fip": "#0072B2",
    "linden": "#009E73",
    "constrained": "#CC79A7",
}
STYLE = {
    "truth": "-",
    "standard": (0, (5, 1.5)),
    "zeroed": (0, (3, 1, 1, 1)),
    "fip": (0, (1, 1.2)),
    "linden": "-",
    "constrained": "-",
}
