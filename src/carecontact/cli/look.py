"""``carecontact look``: a picture sheet of what a policy sees when a trial begins."""

from __future__ import annotations

from pathlib import Path

from carecontact.cli.vision import chosen_vision
from carecontact.contract.observation import MODALITIES
from carecontact.contract.policy import CAMERAS, PolicyCard
from carecontact.errors import ConfigError
from carecontact.protocols import adapted, load_protocol
from carecontact.reports.pictures.sheet import check_sheet_path, save_sheet
from carecontact.runs.plan import compact
from carecontact.runs.preflight import check_protocol


def look(
    *,
    task: str,
    seed: int,
    protocol: str,
    body: str | None,
    out: Path | None,
    segmenter: str | None = None,
    weights: Path | None = None,
) -> int:
    """``out``: default ``look-<task>-s<seed>.png`` here. Raises ConfigError for what the protocol does not have."""
    loaded = load_protocol(protocol)
    rules = adapted(loaded, body=body, vision=chosen_vision(loaded, segmenter=segmenter, weights=weights))
    ids = [t.id for t in rules.tasks]
    if task not in ids:
        raise ConfigError(f"--task: {task!r} is no task of {rules.id}; valid: {', '.join(ids)}")
    if seed not in rules.randomization.seeds:
        raise ConfigError(f"--seed: {seed} is not in {rules.id}; its seeds: {compact(rules.randomization.seeds)}")
    path = check_sheet_path(out or Path(f"look-{task}-s{seed:03d}.png"))
    check_protocol(rules)
    from carecontact.episode.first_look import first_look

    card = PolicyCard(name="look", modalities=MODALITIES, cameras=CAMERAS)
    observation = first_look(rules, task_id=task, seed=seed, card=card, weights=weights)
    name = rules.task(task).name
    save_sheet(observation, path, title=f"Not told to it: {task} {name}, seed {seed}, {rules.title}.")
    print(f"{path}: {task} seed {seed}, {len(CAMERAS)} cameras")
    return 0
