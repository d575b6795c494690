"""Exports of testing machines become specimens.

The module ``machines/NAME.py`` of a format has two functions:

    records(table: Table, choice: Choice, header: Mapping) -> list[Record]
    recognises(table: Table, choice: Choice) -> bool

The first returns all rows of a table (or of each set in it) in N or kPa and with stretches as
measured, with the cycles of each protocol. The second is True if a sheet is a table of this format.
``machines/choice.py`` lists the formats. A format with fixed columns needs only a map of them:

    COLUMNS = "stretch_x=1 + {X} / 20,stretch_y=1 + {Y} / 20,force_x_N=FX,force_y_N=FY"

    def records(table, choice, header):
        choice = replace(choice, machine="generic", columns=(COLUMNS,))
        return generic.records(table, choice, header)
"""
