"""The virtual laboratory: a sheet with shear, its grips, a tester, in finite elements."""
