"""Every constant that decides what a diagnosis says, with its principle. There is no deciding number elsewhere.

Gains and costs are in 2 ln L. What only sets how accurately something is computed stands where it is computed.
"""

from __future__ import annotations

# -- how often noise alone may speak ----------------------------------------------------------
LEVEL_NAMES = 0.025
"""Probability that noise alone names anything: half of a budget of 5 %."""

LEVEL_STRUCTURE = 0.025
"""Probability that noise alone is called structure without a name: the other half."""

LEVEL_NEXT = 0.10
"""Probability that noise alone names one more effect once one stands. Asking 2.5 % again costs ten points of pairs
found for three points fewer of spurious thirds (measured on sets of 78 columns in 14 classes)."""

# -- which sets are looked at -----------------------------------------------------------------
MOST_EFFECTS = 3
"""Effects in a set: with four, what the recordings of a bench hold no longer tells sets apart. The price alone lets
five or six names stand on real prints, for twice the work; some help on data held out, others make it worse."""

INFLATED = 20.0
"""Two columns whose joint variance inflation is larger are one: no pair of them is a set of two."""

SINGLES, PAIRS, NEXT, INSTEAD = 5, 2, 3, 3
"""Refits of a round: single effects, pairs that beat every single one; beside a model: effects added, and effects in
the place of each. The first are the ones that the linear screen puts first; a round begins anew where it ends."""

BY_SWITCH = 2
"""Switches of an effect that are tried, at each place that it may take: those that the screen puts first. To first
order the sag of a field stood a fifth behind its tilt, and refitted it was the better one. Every further one is one
more refit at every place."""

HALF = 0.5
"""An effect that explains less than this share of what the best explains, to first order, is not refitted first. And a
spot of which wider bumps explain less is no wider than a pixel: a spike, or what is left of a corner."""

ROUNDS = MOST_EFFECTS + 1
"""Linearise, enumerate, refit, estimate the noise beside the best set: at most so often; one effect takes two rounds,
each further one another. Most recordings take one to three. Where the set still changes then, as it did on eight real
prints, it changes between look-alikes, and these the classes hold."""

BLEMISHES, LOCAL = 5, 0.1
"""Spots that are left out at most, all recordings together: what has more of them has structure. And the share of a
recording's points that one may have: what is wider is no spot. 0.1 and 0.5 answer the mission's cases alike."""

REACH = 2.0
"""Refits are brought to convergence where they come within so many class widths of the best set: a quick fit may be
one of them too high, and within the other one a look-alike matters. What is none matters only as the best."""

SHORT = 0.3
"""Share of the best gain that the quick fit of a first effect may fall short by and still be looked at again beside
another noise model: where a law bends, derivatives taken before it did find no more."""

# -- noise and choice -------------------------------------------------------------------------
ALIKE = 0.15
"""Two noise models whose strength and length differ by less than this share are one: estimates scatter by as much."""

# -- classes ----------------------------------------------------------------------------------
CREDIBLE = 0.95
"""A class is the smallest set of names that holds this probability of a slot."""

WIDTH = 5.99
"""Distance in 2 ln L at which a rival of one name has 1 − `CREDIBLE` of the probability: −2 ln 0.05."""

FORM_ERROR = 0.05
"""Energy of an effect's signature, as a share, by which a formula may be wrong. Beside one that explains the rest, a
strength has 20 times the variance that it has alone, and no formula is trusted further than that (the bound on the
variance inflation). Two names are told apart by no less."""

MISTAKEN = 0.6
"""Share of an error of an effect's form that another name takes for its own, at most: that much of `FORM_ERROR` it must
gain besides. Of what the library's forms leave of the press's effects, the best other name explains 0.2 in the median
of 28 draws, and 0.6 or less in nine of ten."""

SPREAD, HELD = 0.25, 0.1
"""Standard deviations of what is doubted about the process's own form: of the reach that a width of cross-linking
stands for, as a share of it; and of κ_min from the base of a part to its top. At the detection limit they are hardly
narrower than none at all: other values move little."""

FARTHER = 2.0
"""Times as far that tails of cross-linking reach, as large a share of it as makes that spread. With 1.5 or 3 times the
doubts hold nearly as much of the press's errors of form: 0.81 and 0.82 in the median of 17 cases for 0.83, and 0.75
without tails."""

POSSIBLE = 3.0
"""Standard deviations that a doubt is wrong by at most. It goes with the spread's square: reaches spread by 0.43.
Beside an effect of 3.7 times its limit, unlimited doubts took 16, and eight tenths of what the effect explains."""

UNDOUBTED = 0.5
"""What an error of the process's form leaves beside these doubts, as a share of what they explain. Of what calibration
leaves of the press's errors of form they hold 0.85 in the median of 50 cases, 0.65 or more in nine of ten, and once
0.30: 0.5 is what is left where they hold two thirds. As much more a name must gain."""

SPLITS, REPRODUCED = 5, 0.8
"""Times that recordings are halved at random, and the share of halves that must agree on a name: with eight of ten a
name that chance puts into a half every other time passes once in twenty."""

# -- verdict ----------------------------------------------------------------------------------
EXPLAINED = 0.9
"""The named effects must explain this share of what forms without a name explain, where a remainder is significant."""

POWER = 1.28
"""Standard deviations above the threshold at which an effect is found nine times in ten: `not_testable` is one that
does not reach them at the end of its range."""

ALONG_LINES = 2.0
"""Periods along the lines of a known scan up to which a wave lies across them and is not the print's: offsets and tilts
of lines have no more."""

SHORTEST_PX = 3.0
"""Pixels, of the map or of the instrument, that a wave has at least. Cubics between pixels keep a wave to two thirds of
the Nyquist frequency, and noise of shorter ones not evenly: in 5 of 41 maps that were turned one seemed to be there."""

SEEN, TAKEN = 5.0, 0.3
"""An effect whose typical size stands out so many standard deviations with the process fixed, but of whose signature
the process takes all but this share, has a second column: what is left of it beyond the tangents. A tenth of the energy
is where the bend of a law counts as much as its tangent."""
