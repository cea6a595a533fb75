"""What stands above the tables of draws, levels, factors and gates."""

from __future__ import annotations

from carecontact.reports.text import NA

OVER_PERSONS = (
    "Intervals are over persons: whole seeds are drawn, those of one body among themselves. Where all persons fare "
    "alike, the interval is that of as many trials as there are persons."
)
NOTES = {
    "Spread over the draws": (
        "A draw is one combination of the axes and one seed. Median and, in brackets, where there are six trials, the "
        "5th and 95th percentile over the trials of one task for which a score is defined; n where those are not all."
    ),
    "Draws in which two policies change places": (
        "In how many of the draws that both have, the two stand the other way round than over all of them, where "
        "passes are counted and medians compared: the chance that the order flips with the person who is drawn. "
        f"{NA}: the two are equal over all, or no draw has a number of both."
    ),
    "Success over level": (
        f"{OVER_PERSONS} Above the best blind: points above the blind baseline that passes most often at the level, "
        "over the same trials. Worst tenth: the mean rate of the tenth of the persons who fare worst; by chance: what "
        "it would be if all persons were alike. Harder band: trials that would pass narrower gates, which are no gate. "
        "Only methods are ranked, where there are two or more."
    ),
    "By task": "Passed trials of each task.",
    "Methods against each other": (
        "Points, over the trials that both have. The test permutes whole persons; its p-values are adjusted over all "
        "rows."
    ),
    "One factor at a time": (
        "Each factor of the hard level switched on alone on the easy level, and switched off alone on the hard one; "
        "differences in points, against the level with none and with all. A factor that breaks a policy has a negative "
        "first difference or a positive second one. The test permutes whole persons; its p-values are adjusted over "
        "all rows."
    ),
    "The order under other gates": (
        "The smallest Kendall's tau-b with the order under the protocol's own gates, over the values of each gate, and "
        "the value where it is; only the gates of the actions that ran. 1: the same order everywhere; -1: the reverse "
        "somewhere; NA: nothing is ordered."
    ),
}
"""Title of a table -> what it shows."""
