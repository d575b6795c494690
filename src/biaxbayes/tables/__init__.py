"""Tables of other programs: text, workbooks, MATLAB and LabVIEW files become rows of text cells.

``sheets.py`` reads a file of any format into sheets of cells, formats other than text in a child
process with limited memory (``child.py``); ``table.py`` finds names, units and rows in them.
"""
