"""Makes one line about the effect of each input."""

from __future__ import annotations

from carecontact.trials.deep.ablation import Effect
from carecontact.trials.finding import Finding


def effect_finding(effect: Effect) -> Finding:
    """Return a warning if an input without effect is probably a mistake, and a hint if it may be none."""
    name = effect.input.name
    if effect.refused:
        return Finding(level="ok", topic="input", text=f"{name}: used; the policy refuses it blanked")
    repeats = f"repeats differ by {effect.spread:.2g}" if effect.spread else "repeats are equal"
    calls = f"{effect.calls} call{'' if effect.calls == 1 else 's'}"
    seen = f"blanked, the answer moves by {effect.moved:.2g}, {repeats} ({calls})"
    if effect.verdict == "used":
        return Finding(level="ok", topic="input", text=f"{name}: used; {seen}")
    if effect.verdict == "unclear":
        return Finding(level="hint", topic="input", text=f"{name}: no effect seen in too few calls to tell; {seen}")
    if not effect.input.needed:
        return Finding(level="hint", topic="input", text=f"{name}: no effect; {seen}. Many policies do without it")
    why = "the server does not read this key, expects it under another name, or ignores it"
    return Finding(level="warning", topic="input", text=f"{name}: no effect; {seen}: {why}")
