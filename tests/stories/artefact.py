"""End to end: what may belong to the microscope is not printed into the next part."""

from __future__ import annotations

from tests.stories.bench import Bench
from tests.stories.round_trip import BOLD, PICTURES, Trip, round_trip
from tests.stories.story import Claim, Told, besides, first_class, verdict

TITLE = "A fault of the microscope is not printed"
SLOPE = {"name": "slope-error", "bias_um": 0.08}
WORSE = 0.02
"""The share by which the true shape error may rise above the seven-parameter correction's."""

TRIED = """Told before with a microscope that blurs by 1 µm. The seven parameters absorbed the blur and `diagnose` found
nothing; the printed shape was no worse for it, but there was nothing to tell. What was first claimed of the present
fault, that it is named on the side of the measurement, did not hold: the side is left open."""


def tell(bench: Bench) -> Told:
    """Run the story."""
    return told(round_trip(bench, artefacts=[SLOPE]))


def told(trip: Trip) -> Told:
    """Put the story into words."""
    found, sides = trip.diagnosis, [one["side"] for one in trip.diagnosis["findings"]]
    said = verdict(found)
    text = f"""
The press follows the paper's model; only the microscope reads slopes too high. Three parts are recorded:
{trip.aligned()}. `diagnose` says: *{said}*
(side: {", ".join(sides) or "none"}).{besides(found, SLOPE["name"])}
Every target is corrected with the seven parameters and with what was found, and printed again; the press's true
surfaces are compared with the targets, 2 µm inside the outline:

{trip.table()}

`precompensate` leaves effects of the measurement out: the fault is taken off the recording, not written into the part.
{refused(trip)}

{TRIED if "undecided" in sides else ""}
"""
    claims = (
        Claim("the fault is in the first class named, and nothing is taken for the print's alone",
              f"{said}; side {', '.join(sides) or 'none'}",
              SLOPE["name"] in first_class(found) and "print" not in sides),
        Claim("where the side is open, `precompensate` refuses to choose",
              trip.refusal or "no side is open", bool(trip.refusal) == ("undecided" in sides)),
        Claim(f"the true shape error is not more than {WORSE:.0%} above the seven-parameter correction's",
              f"{trip.change():+.1%}", trip.change() <= WORSE),
    )  # fmt: skip
    concealed = f"`slope-error` of the microscope, {SLOPE['bias_um']:g} µm per slope squared"
    return Told(TITLE, concealed, text, claims, PICTURES, {"diagnosis": said, "sides": sides, **trip.figures()})


def refused(trip: Trip) -> str:
    """Return what became of a class whose side is open."""
    if BOLD not in trip.off_um:
        return ""
    return (
        "Where the side is open it refuses, and leaves the choice to whoever knows the instrument. Here what may be\n"
        "the microscope's is not corrected. Taken for the print's instead, the error changes by\n"
        f"{trip.change(BOLD):+.0%} against the seven parameters: this is what the refusal is for."
    )
