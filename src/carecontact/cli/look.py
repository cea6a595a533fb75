"""``carecontact look``: a picture sheet of what a policy sees when a trial begins."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from carecontact.cli.groups import FLAT, RulesGroup, SaltGroup, VisionGroup

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, kw_only=True)
class Look:
    """Draw on one sheet everything that a policy can receive when a trial begins: every camera and every modality."""

    task: str
    """Task of the protocol, such as T1."""
    seed: int = 0
    """Seed of the protocol."""
    rules: Annotated[RulesGroup, FLAT] = field(default_factory=RulesGroup)
    tool: str | None = None
    """What the robot's hand wears in place of the protocol's: rigid `caps` over the fingertips, or a soft wash `mitt`.
    The sheet names this change."""
    vision: Annotated[VisionGroup, FLAT] = field(default_factory=VisionGroup)
    salted: Annotated[SaltGroup, FLAT] = field(default_factory=SaltGroup)
    out: Path | None = None
    """Picture to write, .png, .jpg or .pdf; default: look-TASK-sSEED.png in the current folder."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        """Raises ConfigError for a task or seed that the protocol does not have."""
        from carecontact.cli.one_trial import check_trial
        from carecontact.cli.vision import with_vision
        from carecontact.contract.observation import MODALITIES
        from carecontact.contract.policy import CAMERAS, PolicyCard
        from carecontact.protocols import load_protocol
        from carecontact.reports.pictures.sheet import check_sheet_path, save_sheet
        from carecontact.runs.preflight import check_protocol
        from carecontact.trials.machine import check_ready

        loaded = load_protocol(self.rules.protocol, level=self.rules.level)
        rules = self.rules.changed(loaded, tool={} if self.tool is None else {"scene.tool": self.tool})
        rules = with_vision(rules, self.vision)
        check_trial(rules, task=self.task, seed=self.seed)
        trial = f"{self.task}-s{self.seed:03d}"
        path = check_sheet_path(self.out or Path(f"look-{trial}.png"))
        check_protocol(rules)
        check_ready()
        from carecontact.episode.first_look import first_look  # Not before, since MuJoCo comes with it.

        card = PolicyCard(name="look", modalities=MODALITIES, cameras=CAMERAS)
        observation = first_look(
            rules, task_id=self.task, seed=self.seed, card=card, weights=self.vision.weights, salt=self.salted.salt
        )
        name = rules.task(self.task).name
        title = f"{self.task} {name}, seed {self.seed}, {rules.title} (the policy does not receive this line)"
        save_sheet(observation, path, title=title)
        print(f"{path}: {self.task} seed {self.seed}, {len(CAMERAS)} cameras")
        return 0
