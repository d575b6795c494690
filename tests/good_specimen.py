"""The text of a good specimen file, of one path or of several."""

HEADER = (
    "# specimen: A12\n# layer: media\n# geometry: unloaded\n"
    "# edge_x_mm: 20\n# edge_y_mm: 18\n# thickness_mm: 1.35\n# load_noise_N: 0.0006\n"
)
NAMES = "stretch_x,stretch_y,force_x_N,force_y_N\n"
ROWS = [
    f"{1 + 0.01 * i:.4f},{1 + 0.008 * i:.4f},{0.01 + 0.02 * i**1.5:.6f},{0.008 + 0.03 * i:.6f}"
    for i in range(12)
]
BODY = "\n".join(ROWS) + "\n"
TABLE = NAMES + BODY
GOOD = HEADER + TABLE


def protocols(*names: str) -> str:
    """One path per name, one below the other."""
    return HEADER + "protocol," + NAMES + "".join(f"{name},{r}\n" for name in names for r in ROWS)
