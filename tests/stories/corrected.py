"""End to end: a concealed effect of the print is found in raw recordings, corrected, and the next print is better."""

from __future__ import annotations

from tests.stories.bench import Bench
from tests.stories.round_trip import PICTURES, round_trip
from tests.stories.story import Claim, Told, besides, verdict

TITLE = "A concealed effect corrected, from raw recordings to the next print"
MEMORY = {"name": "dose-memory", "gain": 0.12, "length_um": 6.0, "model": "time"}
CONVERSION = 0.3
LOWER = 0.30
"""The share by which the true shape error is to fall below the seven-parameter correction's."""


def tell(bench: Bench) -> Told:
    """Run the story."""
    trip = round_trip(bench, effects=[MEMORY], conversion=CONVERSION)
    named = [name for one in trip.diagnosis["findings"] for name in one["effects"]]
    text = f"""
Three parts are printed and recorded: {trip.aligned()}. The recordings are aligned and calibrated together, and
`diagnose` says: *{verdict(trip.diagnosis)}*.{besides(trip.diagnosis, MEMORY["name"])}
Then every target is corrected twice, with the seven parameters and with
what was found, and both go to the same press again. Its true surfaces are compared with the targets, 2 µm inside the
outline:

{trip.table()}
"""
    claims = (
        Claim("the concealed effect is among what is named", verdict(trip.diagnosis), MEMORY["name"] in named),
        Claim(f"the true shape error falls at least {LOWER:.0%} below the seven-parameter correction's",
              f"{trip.change():+.0%}", trip.change() <= -LOWER),
    )  # fmt: skip
    concealed = f"`dose-memory` (lines in time, gain {MEMORY['gain']:g}, {MEMORY['length_um']:g} µm; η {CONVERSION:g})"
    return Told(TITLE, concealed, text, claims, PICTURES, {"diagnosis": verdict(trip.diagnosis), **trip.figures()})
