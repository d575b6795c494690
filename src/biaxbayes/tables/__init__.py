"""Tables of other programs: text, workbooks, MATLAB and LabVIEW files become rows of text cells.

``sheets.py`` reads a file of any format into sheets of cells, ``table.py`` finds names, units and
rows in them. Limits are checked before anything is unpacked.
"""
