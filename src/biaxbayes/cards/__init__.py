"""Material cards for finite-element programs."""
