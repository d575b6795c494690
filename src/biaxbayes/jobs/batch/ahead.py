"""Imports of a process that runs are sampled in, done where no other thread is there.

Of some packages what is not used is left out, which only such a process can do; its copies have it
all.
"""

from __future__ import annotations

from biaxbayes.lean_imports import array_stats, corner_package

__all__ = ["array_stats"]

corner_package()
