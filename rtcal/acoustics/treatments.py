"""Treatments of a room, and their cost; its file, and its areas on the room's materials.

::

    probability = 0.8                   # optional, 0.8 or more

    [target]
    standard = "DIN 18041"              # or "ANSI S12.60", which has no group
    group = "A3"                        # or in place of both: low and high in s, each one number or
                                        # one per band

    [[material]]                        # as in a file of variants
    name = "panel"
    alpha = [0.2, 0.6, 0.9, 0.9, 0.9, 0.9]
    sigma = 0.1

    [[treatment]]
    name = "panels on the ceiling"
    material = "panel"                  # a new material, or one of the room
    covers = "ceiling"                  # left out: free-standing
    largest = 40                        # m²
    cost = 90                           # per m²
    unit = 1.44                         # m²; optional: only whole panels
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rtcal.acoustics.change_files import (
    Catalogue,
    material_name,
    new_materials,
    stated_target,
    tables,
)
from rtcal.acoustics.changes import MOST_ADDED, Add, Change, Cover
from rtcal.acoustics.materials import Material
from rtcal.acoustics.room import Room
from rtcal.acoustics.targets import Target
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.decode import Entries, toml_table
from rtcal.support.errors import DataError

LEAST = 0.8
"""Least probability that a design takes: below it the allowed sd is no concave function of the mean."""

MOST_COST = 1e9
"""Largest cost per m²: larger numbers are slips, and leave no digits to the others."""
MOST_PANELS = 500
"""Most whole panels of a treatment: with more, whole ones are no rule that costs anything."""


@checked
@dataclass(frozen=True)
class Treatment:
    """A material that may be put into the room.

    Parameters
    ----------
    name : str
    material : Material or str
        A str is a material of the room.
    largest : float
        Largest area in m².
    cost : float
        Per m², in any currency; 0 or more.
    covers : str, optional
        The room's material that it covers; free-standing if not given.
    unit : float, optional
        Area of one panel in m²; any area if not given.

    Raises
    ------
    DataError
        If a number breaks a rule, or a unit is larger than the largest area.

    Examples
    --------
    >>> panel = Material("panel", [0.9], [0.1])
    >>> Treatment("on the ceiling", panel, largest=40, cost=90, covers="ceiling", unit=1.44).unit
    1.44
    """

    name: str
    material: Material | str
    largest: float
    cost: float
    covers: str | None = None
    unit: float | None = None

    def __post_init__(self) -> None:
        place = f'treatment "{self.name}": '
        checks.positive(f"{place}largest", self.largest, "m²")
        if not 0 <= checks.number(f"{place}cost", self.cost) <= MOST_COST:
            raise DataError(f"{place}cost = {self.cost:g} is not from 0 to {MOST_COST:g} per m²")
        if self.unit is None:
            return
        if checks.positive(f"{place}unit", self.unit, "m²") > self.largest:
            raise DataError(
                f"{place}unit = {self.unit:g} m² is more than largest = {self.largest:g} m²"
            )
        if self.largest > MOST_PANELS * self.unit:
            raise DataError(
                f"{place}unit = {self.unit:g} m² allows more than {MOST_PANELS} panels in largest = "
                f"{self.largest:g} m²; left out, any area may be had"
            )

    def change(self, area: float) -> Change:
        """Return the change that puts so many m² of it into the room."""
        if self.covers is None:
            return Add(self.material, area)
        return Cover(self.covers, self.material, area)

    @property
    def material_name(self) -> str:
        """The name of its material."""
        return self.material if isinstance(self.material, str) else self.material.name


@checked
def read_treatments(
    content: str, room: Room, catalogue: Catalogue | None = None
) -> tuple[tuple[Treatment, ...], Target, float]:
    """Return the treatments, the target and the probability of a TOML text.

    Parameters are those of `rtcal.prediction.read_variants`, and so are the errors.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> treatments, target, probability = read_treatments('''
    ... [target]
    ... standard = "ANSI S12.60"
    ... [[treatment]]
    ... name = "more floor"
    ... material = "floor"
    ... covers = "plaster"
    ... largest = 10
    ... cost = 20
    ... ''', room)
    >>> treatments[0].covers, target.high[2], probability
    ('plaster', np.float64(0.6), 0.8)
    """
    file = Entries("", toml_table(content), ("treatment", "target"), ("material", "probability"))
    target = stated_target(file, room)
    new = new_materials(file, room, catalogue)
    treatments = []
    for place, table in tables(file, "treatment"):
        entry = Entries(
            f"{place}: ", table, ("name", "material", "largest", "cost"), ("covers", "unit")
        )
        named = material_name(entry, "material", room, new)
        treatments.append(
            Treatment(
                name=entry.text("name"),
                material=new.get(named, named),
                largest=entry.number("largest"),
                cost=entry.number("cost"),
                covers=material_name(entry, "covers", room, {}) if "covers" in entry else None,
                unit=entry.number("unit") if "unit" in entry else None,
            )
        )
    return tuple(treatments), target, file.number("probability", LEAST)


def check_treatments(treatments: Sequence[Treatment], room: Room) -> tuple[Treatment, ...]:
    """Return the treatments; DataError if there are none, two of a name, or one that does not fit."""
    listed = tuple(treatments)
    if not listed:
        raise DataError("treatments is empty; there is at least one")
    names = [t.name for t in listed]
    if repeated := sorted({n for n in names if names.count(n) > 1}):
        raise DataError(f'treatments has "{repeated[0]}" twice')
    for treatment in listed:
        if treatment.covers is not None:
            has = float(room.areas[room.material_index(treatment.covers)])
            if treatment.largest > has * (1 + 1e-9):
                raise DataError(
                    f'treatment "{treatment.name}": largest = {treatment.largest:g} m² is more than '
                    f'the {has:g} m² of "{treatment.covers}"'
                )
        elif treatment.largest > (most := MOST_ADDED * room.total_area):
            raise DataError(
                f'treatment "{treatment.name}": largest = {treatment.largest:g} m² is more than '
                f"{most:g} m², {MOST_ADDED:g} times the room's surface"
            )
    return listed
