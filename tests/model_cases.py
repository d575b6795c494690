"""Specimens that GOH does not describe."""

from dataclasses import replace

import numpy as np

from biaxbayes.specimens.specimen import Specimen


def bent(data: Specimen, name: str, share: float) -> Specimen:
    """The specimen with one protocol's y loads off by a share of their peak halfway."""
    protocols = []
    for p in data.protocols:
        load = np.array(p.load_y)
        if p.name == name:
            load += share * load.max() * np.sin(np.linspace(0.0, np.pi, p.rows))
        protocols.append(replace(p, load_y=load))
    return replace(data, protocols=tuple(protocols))
