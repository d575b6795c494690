"""The verb that makes a virtual specimen: a test of a known material, and its truth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.jobs.opening import check_new, readable_specimen
from biaxbayes.options import VirtualTest, documented
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import write_specimen

if TYPE_CHECKING:
    from biaxbayes.laws.materials import MaterialResponse
    from biaxbayes.specimens.virtual_specimen import Dimensions, Truth

__all__ = ["simulate", "truth_file"]


@documented(VirtualTest)
def simulate(
    out: str | Path | None = None, *, overwrite: bool = False, **options: Any
) -> tuple[Specimen, Truth]:
    """A virtual biaxial test, written as a specimen file where asked to.

    Parameters
    ----------
    out : path-like, optional
        The CSV; the truth goes into ``<stem>.truth.json`` beside it, which no fit reads.
    overwrite : bool
        Replace files of the same name.
    **options
        As in :class:`~biaxbayes.options.VirtualTest`.

    Raises
    ------
    InputError
        For a test that cannot be, or a file that is there already.
    """
    from biaxbayes.specimens.virtual_specimen import write_truth

    test = VirtualTest.of(options)
    if out is not None:
        _check_files(Path(out), overwrite)
    specimen, truth = _simulated(test, test.name or ("virtual" if out is None else Path(out).stem))
    if out is not None:
        # The truth first: a specimen without its truth would be worth nothing.
        write_truth([truth], truth_file(Path(out)))
        write_specimen(specimen, Path(out))
    return specimen, truth


def truth_file(out: Path) -> Path:
    """Where the truth of a virtual specimen goes."""
    return out.with_name(f"{out.stem}.truth.json")


def _check_files(out: Path, overwrite: bool) -> None:
    if not out.parent.is_dir():
        raise InputError("no such folder", file=out.parent, remedy="make it first")
    for path in (out, truth_file(out)):
        check_new(path, overwrite)


def _simulated(test: VirtualTest, name: str) -> tuple[Specimen, Truth]:
    """The specimen that the options ask for."""
    from biaxbayes.fem.sheet_tester import Hooks
    from biaxbayes.laws.goh import GOH
    from biaxbayes.specimens.virtual_specimen import Machine, hooked_specimen, virtual_specimen

    material, conditions, dimensions = _conditions(test)
    if test.hooks and not isinstance(material, GOH):
        raise InputError(
            f"--hooks computes a sheet with shear, which the law {material.law.name} does not "
            "define here",
            remedy="leave --hooks out, or give a material of goh",
        )
    for option, value in (("noise-N", test.noise_N), ("misfit", test.misfit)):
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"--{option} is {value:g}", remedy="give zero or more")
    machine = Machine(
        noise_N=test.noise_N,
        misfit=test.misfit,
        stress_pair=test.stress_pair,
        geometry=test.geometry,
    )
    common: dict[str, Any] = {
        "name": name,
        **conditions,
        "ratios": test.ratios or ((1.0, 1.0),),
        "increments": test.increments,
        "dimensions": dimensions,
        "machine": machine,
        "seed": test.seed,
    }
    try:
        with np.errstate(all="ignore"):  # an overflow is seen in the result
            if isinstance(material, GOH) and test.hooks:
                made = hooked_specimen(material, **common, hooks=Hooks(count=test.hooks))
            else:
                made = virtual_specimen(material, **common)
    except ValueError as error:
        raise InputError(str(error), remedy="see 'biaxbayes simulate --help'") from None
    _check_readable(made[0])
    return made


def _conditions(test: VirtualTest) -> tuple[MaterialResponse, dict[str, Any], Dimensions]:
    """Material, stretches and dimensions: the options, else what is published with a material."""
    from biaxbayes.laws.materials import MaterialResponse
    from biaxbayes.laws.published import MATERIALS, PublishedMaterial
    from biaxbayes.specimens.virtual_specimen import Dimensions

    if isinstance(test.material, MaterialResponse):
        published = PublishedMaterial(test.material, "command line")
    elif test.material in MATERIALS:
        published = MATERIALS[test.material]
    elif test.material is None:
        raise InputError(
            "give one of --material NAME and --goh C1 k1 k2 ALPHA KAPPA, or --law with --values",
            remedy="'--material list' prints the names",
        )
    else:
        raise InputError(
            f"no material {str(test.material)[:60]!r}", remedy=f"known are {', '.join(MATERIALS)}"
        )
    material = published.material
    if test.fibre_switch:
        material = _switched(material)
    thickness = test.thickness
    if thickness is None:
        thickness = published.thickness_mm or 1.0
    if not (math.isfinite(thickness) and thickness > 0.0):
        raise InputError(f"a thickness of {thickness:g} mm", remedy="give a positive number")
    edge_x, edge_y = test.edge
    conditions = {**_stretches(test, published), "source": published.source}
    return material, conditions, Dimensions(edge_x, edge_y, thickness)


def _switched(material: MaterialResponse) -> MaterialResponse:
    """The same material whose fibres carry no compression."""
    from biaxbayes.laws import law_named
    from biaxbayes.laws.goh import GOH
    from biaxbayes.laws.materials import StatedMaterial

    if isinstance(material, GOH):
        return replace(material, fibre_switch=True)
    return StatedMaterial(law_named(material.law.name, fibre_switch=True), material.theta)


def _stretches(test: VirtualTest, published: Any) -> dict[str, Any]:
    top: list[Any]
    mounting = test.prestretch or published.mounting_stretch
    if not test.prestretch and published.mounting_stretch == (1.0, 1.0):
        raise InputError(
            "no mounting stretch is published with this material",
            remedy="give --prestretch X Y ('--prestretch 1 1' for none)",
        )
    total, measured = test.total_stretch, test.measured_stretch
    if total is not None and measured is not None:
        raise InputError("--total-stretch and --measured-stretch are given", remedy="give one")
    if total is None and measured is None:
        measured = published.measured_stretch
    if total is None and measured is None:
        raise InputError(
            "no stretch range is published with this material",
            remedy="give --total-stretch or --measured-stretch",
        )
    top = [measured, measured] if total is None else [total / lm if lm else 0.0 for lm in mounting]
    for flag, values in (("--prestretch", mounting), ("largest measured stretch", top)):
        for value in values:
            if not 0.5 <= value <= 3.0:
                raise InputError(
                    f"{flag} of {value:g}", remedy="stretches are ratios near 1, such as 1.02"
                )
    if 1.0 in top:
        raise InputError("the test ends where it starts", remedy="ask for a larger stretch")
    return {
        "mounting_stretch": tuple(mounting),
        "total_stretch": total,
        "measured_stretch": measured,
    }


def _check_readable(specimen: Specimen) -> None:
    """Refuse a simulation that ``read_specimen`` would refuse (too large a stress and the like)."""
    try:
        readable_specimen(specimen, specimen.name)
    except InputError as error:
        raise InputError(
            f"this test gives a record that cannot be used: {error.problem}",
            remedy="ask for another stretch, ratio or material",
        ) from None
