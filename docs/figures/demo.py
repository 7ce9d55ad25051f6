"""Draw docs/img/demo.png, what the demo prints. Run: COLUMNS=190 treadwatch demo --once | python docs/figures/demo.py."""  # noqa: INP001, E501 - a script, not a package; a command to copy

from __future__ import annotations

import sys
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

POINTS, WIDTH, HEIGHT, MARGIN = 8.0, 4.82, 9.4, 12.0  # of the font, of a character, of a line, round the text
DOTS = 110
INK, PAPER, GOOD, BAD = "#e6e6e6", "#16191d", "#7bd88f", "#ff7b72"


def main() -> None:
    """Draw the text of standard input as a terminal shows it."""
    lines = [line.rstrip() for line in sys.stdin.read().splitlines()]
    width = max(map(len, lines)) * WIDTH + 2 * MARGIN
    height = len(lines) * HEIGHT + 2 * MARGIN
    figure = Figure(figsize=(width / 72, height / 72), facecolor=PAPER)
    FigureCanvasAgg(figure)
    for row, line in enumerate(lines):
        y = 1 - (MARGIN + (row + 0.8) * HEIGHT) / height
        colour = INK
        if "conicity_limit" in line or "no_data" in line:
            colour = BAD
        elif "intervals cover" in line:
            colour = GOOD
        figure.text(MARGIN / width, y, line, family="DejaVu Sans Mono", fontsize=POINTS, color=colour, parse_math=False)
    target = Path(__file__).resolve().parent.parent / "img" / "demo.png"
    figure.savefig(target, dpi=DOTS, facecolor=PAPER, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
