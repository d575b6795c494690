"""Make the virtual specimens in ``data/``: known material, known mounting stretch, honest errors.

    python scripts/make_specimens.py [--out data]

Five homogeneous specimens are the rows of Table 6 of Math. Comput. Appl. 2024, 29(4), 55 that
infer the prestretch, with the dimensions and stretch ranges of its Table 2. Two more are held by
five hooks an edge and computed in finite elements (scikit-fem): their error is not a random one.

The seeds are 551, 552, ...: article 55, specimen 1, 2, ... They were written down before any
fit was run and have not been changed since; another choice would serve as well, and how the
intervals do over other seeds stands beside the shipped ones in ``data/README.md``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from biaxbayes.errors import InputError
from biaxbayes.fem.sheet_tester import Hooks
from biaxbayes.laws.published import MATERIALS, PublishedMaterial
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.specimens.truth import Truth, write_truth
from biaxbayes.specimens.virtual_specimen import (
    Dimensions,
    Machine,
    virtual_specimen,
)

EDGE_MM = 20.0
INCREMENTS = 100
NOISE_N = 0.0006  # resolution of the load cell, Section 2.4
MISFIT = 0.02
FIRST_SEED = 551
LAYERS = {
    "donor1": "wall",
    "donor2": "wall",
    "donor2-intima": "intima",
    "donor2-media": "media",
    "donor2-adventitia": "adventitia",
}
AXES = {"axis_x": "circumferential", "axis_y": "axial"}


def table6_specimen(
    name: str, seed: int, published: PublishedMaterial | None = None, misfit: float = MISFIT
) -> tuple[Specimen, Truth]:
    """The shipped specimen of this name, with any seed, of this or another material."""
    published = published or MATERIALS[name]
    return virtual_specimen(
        published.material,
        name=name,
        machine=Machine(noise_N=NOISE_N, misfit=misfit),
        seed=seed,
        labels={"layer": LAYERS[name], **AXES},
        **conditions(published),
    )


def conditions(published: PublishedMaterial) -> dict[str, Any]:
    """The test of Table 2 that a published material was determined from."""
    assert published.thickness_mm is not None
    return {
        "mounting_stretch": published.mounting_stretch,
        "measured_stretch": published.measured_stretch,
        "increments": INCREMENTS,
        "dimensions": Dimensions(EDGE_MM, EDGE_MM, published.thickness_mm),
        "source": published.source,
    }


def hooked_media(name: str, seed: int) -> tuple[Specimen, Truth]:
    """The media of donor 2 as above, but on hooks."""
    published = MATERIALS["donor2-media"]
    return virtual_specimen(
        published.material,
        name=name,
        hooks=Hooks(),
        machine=Machine(noise_N=NOISE_N),
        seed=seed,
        labels={"layer": "media", **AXES},
        **conditions(published),
    )


def hooked_weisbecker(name: str, seed: int) -> tuple[Specimen, Truth]:
    """The stiffening material of Table 1 at the paper's largest prestretch, on hooks."""
    thickness = MATERIALS["donor2-media"].thickness_mm  # none is printed for this material
    assert thickness is not None
    return virtual_specimen(
        MATERIALS["weisbecker-media"].material,
        name=name,
        hooks=Hooks(),
        mounting_stretch=(1.02, 1.02),
        total_stretch=1.2,
        increments=INCREMENTS,
        dimensions=Dimensions(EDGE_MM, EDGE_MM, thickness),
        machine=Machine(noise_N=NOISE_N),
        seed=seed,
        labels={"layer": "media", **AXES},
        source="Table 1",
    )


HOOKED: dict[str, Callable[[str, int], tuple[Specimen, Truth]]] = {
    "hooked-media": hooked_media,
    "hooked-weisbecker": hooked_weisbecker,
}


def make(folder: Path) -> None:
    """Write all specimens and their truth; without scikit-fem the hooked ones stay as they are."""
    folder.mkdir(parents=True, exist_ok=True)
    truths = []
    makers = dict.fromkeys(LAYERS, table6_specimen) | HOOKED
    for index, (name, maker) in enumerate(makers.items()):
        try:
            specimen, truth = maker(name, FIRST_SEED + index)
        except InputError as error:
            print(f"{name}: skipped, {error}")
            truths.extend(_known(folder, name))
            continue
        write_specimen(specimen, folder / f"{name}.csv")
        truths.append(truth)
        print(f"{name}: {sum(p.rows for p in specimen.protocols)} rows, seed {truth.seed}")
    write_truth(truths, folder / "truth.json")


def _known(folder: Path, name: str) -> list[Truth]:
    path = folder / "truth.json"
    entries = json.loads(path.read_text()) if path.exists() else {}
    return [Truth(**entries[name])] if name in entries else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "data")
    make(parser.parse_args().out)


if __name__ == "__main__":
    main()
