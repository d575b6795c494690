"""Where compiled code is kept between runs.

Numba notices a change of the file that a compiled function stands in, not of the files that it
calls. Keyed by all sources that are compiled, the cache can never serve a density of yesterday's
mechanics.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numba
import platformdirs

__all__ = ["use_own_cache"]


def use_own_cache() -> None:
    """Keep compiled code in the user's cache, unless ``NUMBA_CACHE_DIR`` says where."""
    config: Any = numba.config
    if config.CACHE_DIR:
        return
    digest = hashlib.sha256()
    package = Path(__file__).parent.parent
    for folder in ("mechanics", "inference"):
        for source in sorted((package / folder).glob("*.py")):
            digest.update(source.read_bytes())
    config.CACHE_DIR = str(Path(platformdirs.user_cache_dir("biaxbayes")) / digest.hexdigest()[:16])
