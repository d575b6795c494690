"""Exports of testing machines become specimens.

The module ``machines/NAME.py`` of a format has two functions:

    recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]
    recognises(table: Table, choice: Choice) -> bool

The first takes from a table of text what was chosen (:class:`~biaxbayes.machines.choice.Choice`):
one recording per protocol, in N or kPa and with stretches as measured. The second says whether a
sheet beside others is a table of this format. ``machines/choice.py`` lists the formats.
"""
