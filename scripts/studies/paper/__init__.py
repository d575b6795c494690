"""Everything that the method paper prints, recomputed: Math. Comput. Appl. 2024, 29(4), 55."""
