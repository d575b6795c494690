"""Exports of testing machines become specimens.

The module ``machines/NAME.py`` of a format has two functions:

    recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]
    recognises(table: Table, choice: Choice) -> bool

The first returns one recording per protocol as selected by ``choice``
(:class:`~biaxbayes.machines.choice.Choice`), in N or kPa and with stretches as measured. The second
is True if a sheet is a table of this format; ``table.preamble`` has the lines above the column
names. ``machines/choice.py`` lists the formats. A format with fixed columns needs only a map of
them, for example

    COLUMNS = "stretch_x=X:displacement_mm,stretch_y=Y:displacement_mm,force_x_N=FX,force_y_N=FY"

    def recordings(table, choice, gauge):
        return generic.recordings(table, replace(choice, columns=(COLUMNS,)), gauge)
"""
