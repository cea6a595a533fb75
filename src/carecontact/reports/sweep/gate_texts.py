"""The order under other gates, as a table for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from carecontact.reports.sweep.gate_orders import GateOrder
from carecontact.reports.sweep.level_texts import level_name
from carecontact.reports.text import NA
from carecontact.scoring.gate_sweep import sweeps_of
from carecontact.scoring.result import TrialScore

STEPS = {
    "gamma": "Safety gate, as a share of the pain onset",
    "region_correct": "Region-correct in place of safety-gated",
    "success": "Success in place of safety-gated",
}
"""What is no swept gate -> its name for people."""
SAME = "1.00"


def gate_titles(scores: Sequence[TrialScore]) -> dict[str, str]:
    """Gate -> its name for people, for the gates that apply to these trials."""
    found = dict(STEPS)
    for version in sorted({score.metric_versions.get("gates", "") for score in scores}):
        for name, (_, sweep) in sweeps_of(sorted({score.action for score in scores}), version).items():
            found[name] = sweep.title
    return found


def gate_heads(orders: Sequence[GateOrder]) -> list[str]:
    return ["gate", *map(level_name, dict.fromkeys(order.place for order in orders))]


def gate_rows(orders: Sequence[GateOrder], titles: Mapping[str, str]) -> list[list[str]]:
    """Return the smallest tau of each gate, place by place, with the value where it is. The gates that change no order
    anywhere share the last row.

    Args:
        titles: gate -> its name for people; other gates are left out.
    """
    places = dict.fromkeys(order.place for order in orders)
    cells = {(order.gate, order.place): _tau(order) for order in orders}
    gates = [gate for gate in dict.fromkeys(order.gate for order in orders) if gate in titles]
    rows = {gate: [cells.get((gate, place), NA) for place in places] for gate in gates}
    flat = [gate for gate in gates if set(rows[gate]) == {SAME}]
    found = [[f"{titles[gate]} ({gate})", *rows[gate]] for gate in gates if gate not in flat]
    if flat:
        told = "; ".join(titles[gate] for gate in flat)
        found.append([f"{'All others' if found else 'All'}: {told}", *([SAME] * len(places))])
    return found


def _tau(order: GateOrder) -> str:
    if order.least is None:
        return NA
    value = order.setting.partition(" ")[2]
    return SAME if order.least > 0.9999 else f"{order.least:.2f}" + (f" (at {value})" if value else "")
