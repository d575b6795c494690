"""Tables of other programs: text, workbooks, MATLAB and LabVIEW files become rows of text cells."""
