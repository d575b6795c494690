"""A hierarchical posterior over specimens, from their finished runs."""

from biaxbayes.compilation import use_own_cache

use_own_cache()
