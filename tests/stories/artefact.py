"""End to end: what belongs to the microscope is named as such and is not printed into the next part."""

from __future__ import annotations

from tests.stories.bench import Bench
from tests.stories.round_trip import PICTURES, round_trip
from tests.stories.story import Claim, Told, verdict

TITLE = "A fault of the microscope is not printed"
BLUR = {"name": "instrument-blur", "fwhm_um": 1.0}
WORSE = 0.02
"""The share by which the true shape error may rise above the seven-parameter correction's."""


def tell(bench: Bench) -> Told:
    """Run the story."""
    trip = round_trip(bench, artefacts=[BLUR])
    sides = [one["side"] for one in trip.diagnosis["findings"]]
    named = [name for one in trip.diagnosis["findings"] for name in one["effects"]]
    text = f"""
The press follows the paper's model; only the microscope blurs. Three parts are recorded: {trip.aligned()}. `diagnose`
says: *{verdict(trip.diagnosis)}* (side: {", ".join(sides) or "none"}). Both corrections are printed; the press's true
surfaces are compared with the targets, 2 µm inside the outline:

{trip.table()}

`precompensate` leaves effects of the measurement out: the blur is taken off the recording, not written into the part.
"""
    claims = (
        Claim("the blur is named, on the side of the measurement",
              f"{verdict(trip.diagnosis)}; side {', '.join(sides) or 'none'}",
              BLUR["name"] in named and set(sides) == {"measurement"}),
        Claim(f"the true shape error is not more than {WORSE:.0%} above the seven-parameter correction's",
              f"{trip.change():+.1%}", trip.change() <= WORSE),
    )  # fmt: skip
    concealed = f"`instrument-blur` of the microscope, {BLUR['fwhm_um']:g} µm"
    return Told(TITLE, concealed, text, claims, PICTURES, {"diagnosis": verdict(trip.diagnosis), **trip.figures()})
