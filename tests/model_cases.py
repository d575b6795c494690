"""Specimens that GOH does not describe."""

import numpy as np

from biaxbayes.specimens.specimen import Protocol, Specimen


def bent(data: Specimen, name: str, share: float) -> Specimen:
    """The specimen with one protocol's y loads off by a share of their peak halfway."""
    protocols = []
    for p in data.protocols:
        load = np.array(p.load_y)
        if p.name == name:
            load += share * load.max() * np.sin(np.linspace(0.0, np.pi, p.rows))
        protocols.append(
            Protocol(p.name, p.stretch_x, p.stretch_y, p.load_x, load, rest_rows=p.rest_rows)
        )
    fields = {k: getattr(data, k) for k in data.__dataclass_fields__}
    return Specimen(**fields | {"protocols": tuple(protocols)})
