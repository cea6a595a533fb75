"""What stands above the tables of levels, factors and gates."""

from __future__ import annotations

OVER_PERSONS = (
    "Intervals are over persons: whole seeds are drawn, those of one body among themselves. Where all persons fare "
    "alike, the interval is that of as many trials as there are persons."
)
NOTES = {
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
        "where it is. 1: the same order everywhere; -1: the reverse somewhere; NA: nothing is ordered."
    ),
}
"""Title of a table -> what it shows."""
