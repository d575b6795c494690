"""Consistent unit systems of finite-element input."""

from __future__ import annotations

from dataclasses import dataclass

from biaxbayes.errors import InputError

__all__ = ["UNIT_SYSTEMS", "UnitSystem", "unit_system"]


@dataclass(frozen=True)
class UnitSystem:
    """Units that belong together: force = mass length / time^2, stress = force / length^2.

    Attributes
    ----------
    name, stress, length, force, mass, time : str
    per_kPa : float
        The stress unit's number for 1 kPa.
    """

    name: str
    stress: str
    length: str
    force: str
    mass: str
    time: str
    per_kPa: float

    def __str__(self) -> str:
        return (
            f"{self.name}: stress {self.stress}, length {self.length}, force {self.force}, "
            f"mass {self.mass}, time {self.time}"
        )


UNIT_SYSTEMS = {
    system.name: system
    for system in (
        UnitSystem("kPa-mm", "kPa", "mm", "mN", "kg", "s", 1.0),
        UnitSystem("MPa-mm", "MPa", "mm", "N", "tonne", "s", 1e-3),
        UnitSystem("Pa-m", "Pa", "m", "N", "kg", "s", 1e3),
    )
}


def unit_system(name: str) -> UnitSystem:
    """Unit system by name.

    Raises
    ------
    InputError
        For a name that is not known.
    """
    try:
        return UNIT_SYSTEMS[name]
    except KeyError:
        raise InputError(
            f"no unit system {name[:40]!r}", remedy=f"choose {', '.join(UNIT_SYSTEMS)}"
        ) from None
