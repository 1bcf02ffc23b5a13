"""What a finding, an effect and its parameters are called in a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rtcal.acoustics.room import Room

if TYPE_CHECKING:
    from rtcal.discrepancy.finding import Finding

NATS = "2.3 nats are odds of ten to one"
_UNITS = {
    "temperature": " °C",
    "humidity": " %",
    "thickness": " m",
    "flow_resistivity": " Pa s/m²",
    "resonance": " Hz",
    "area": " m²",
    "aperture": " m²",
    "volume": " m³",
    "level": " dB",
    "gain": " dB",
    "record": " times T",
    "absorption_area": " m² at 1 kHz",
}
_KINDS = {
    "standing": ("seated", "standing"),
    "equation": ("Sabine's equation", "Eyring's equation", "Millington's equation"),
}
_TOGETHER = "found together: only the attenuation that they give is known well"


def material_of(parameters: Mapping[str, float], room: Room) -> str | None:
    """Return the name of the material that the parameters number, None where they number none."""
    number = int(parameters.get("material", -1))
    return room.materials[number] if 0 <= number < room.n_materials else None


def titled(effect: str, parameters: Mapping[str, float], room: Room) -> str:
    """Return the effect with the material that it is of: ``area of "plaster"``."""
    material = material_of(parameters, room)
    return effect if material is None else f'{effect} of "{material}"'


def in_words(parameters: Mapping[str, float], without: str = "") -> str:
    """Return parameters with their units, but for the material and the one named ``without``."""
    parts = []
    for name, value in parameters.items():
        if name in ("material", without):
            continue
        kinds = _KINDS.get(name, ())
        if value in range(len(kinds)):
            parts.append(kinds[int(value)])
        else:
            parts.append(f"{name.replace('_', ' ')} {value:.3g}{_UNITS.get(name, '')}")
    if {"temperature", "humidity"} <= set(parameters) - {without}:
        parts[-1] += f" ({_TOGETHER})"
    return ", ".join(parts)


def amount(value: float, unit: str) -> str:
    """Return a size with its unit; a ratio as so many times.

    >>> amount(2.0, "of the stated area"), amount(12.3, "m²")
    ('2 times the stated area', '12.3 m²')
    """
    if unit.startswith("of "):
        return f"{value:.3g} times {unit.removeprefix('of ')}"
    return f"{value:.3g} {unit}"


def wrong(finding: Finding) -> str:
    """Return how a finding begins: what is stated is wrong, or something is missing, or either."""
    stated = ["volume", "area", "formula"]
    if finding.case.room.air is not None:
        stated.append("air")
    kinds = {name in stated for name in finding.candidates}
    if kinds == {True}:
        return "Not as stated"
    return (
        "Missing from the model" if kinds == {False} else "Missing from the model, or not as stated"
    )


def rivals(finding: Finding) -> list[str]:
    """Return the candidates beside the best."""
    return [c for c in finding.candidates if c != finding.effect]


def listed(names: Sequence[str]) -> str:
    """Return names as one reads them: a, b and c.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def best(finding: Finding) -> str:
    """Return the best supported effect as it is called in a sentence."""
    return titled(str(finding.effect), finding.parameters, finding.case.room)


def standing(finding: Finding) -> str:
    """Return how sure the name is: verdict, the best's evidence, and what is next to it."""
    found = f"{best(finding)} {finding.score:+.1f} nats"
    others = rivals(finding)
    if others:
        told = ", ".join(f"{r} {finding.evidence[r]:+.1f}" for r in others)
        return f"{finding.verdict}: {found}; {told}, not told apart"
    return f"{finding.verdict}: {found}; next {runner_up(finding)}"


def runner_up(finding: Finding) -> str:
    """Return the second best with its evidence."""
    return f"{finding.runner_up} {finding.evidence.get(finding.runner_up, 0.0):+.1f}"


def nothing_to_add(finding: Finding) -> str | None:
    """Return why there is no effect to add, None where there is one."""
    return {
        "none": "Nothing to add: prior, measurement and model agree (verdict none).",
        "hint": f"Nothing to add: a hint of {finding.effect} only, {finding.score:.1f} nats of the "
        f"{finding.threshold:.1f} that it must exceed (verdict hint).",
        "unknown": "Nothing to add: something is missing that no effect of the library explains "
        "(verdict unknown).",
    }.get(finding.verdict)


def added(finding: Finding) -> str:
    """Return what `Finding.apply` has added, and what might as well have been added."""
    others = [
        f"{r} is only {finding.score - finding.evidence[r]:.1f} nats behind"
        for r in rivals(finding)
    ]
    if others:
        return f"Added {best(finding)}. Ambiguous: it is the best, but {listed(others)} ({NATS})."
    return f"Added {best(finding)} ({standing(finding)})."
