"""The score of one trial."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

from carecontact.protocol.protocol import protocol_title

Anatomy = Literal["process_failure", "target", "off_target", "none"]
FailureMode = Literal[
    "process_failure",
    "safety_truncation",
    "no_target_contact",
    "off_target_contact",
    "not_by_tool",
    "lost_contact",
    "insufficient_progress",
    "outside_band",
    "wrong_share",
    "time_limit",
    "joint_beyond_range",
]
Attribution = Literal["process", "perception", "planning", "execution", "safety"]


MEASURED = (
    "c1_peak_force_n", "c1_peak_filtered_n", "c1_peak_contact_sum_n", "c1_peak_any_segment_n", "c2_joint_margin_rad",
    "c2_joint", "c2_time_s", "c2_settled_margin_rad", "c2_change_rad", "c3_success", "c4_motion_activity",
    "c5_force_sd_n", "longest_on_s", "on_share", "stroke_m", "extent_m", "reversals", "wrist_displacement_m",
    "wrist_displacement_any_m",
)  # fmt: skip
"""Fields of ``TrialScore`` that metrics fill."""

DRAWN = "drawn "
"""Before the name of a part of the world that the seed draws (``TrialScore.world``)."""


class TrialScore(BaseModel):
    """The scores of one trial, in SI units. None means NA. Only ``scoring.score_recording`` makes them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    trial_id: str
    task_id: str
    action: str
    region: str
    seed: int
    policy: str
    policy_arguments: dict[str, str] = {}
    """What --policy-arg gave the policy."""
    privileged: bool = False
    """Whether the policy was given the simulation: its rates are a ceiling and rank no method."""
    policy_name: str | None = None
    """The name on the card of a policy behind an address, which says nothing of itself; None for any other."""
    language_backend: str
    language_sha256: str | None = None
    """Hash over everything that language models were asked and answered in this trial; None: nothing was asked."""
    language_endpoint: str | None = None
    """Hosts that live completions came from or were asked of, also when they are replayed; None: no host."""
    language_served: str | None = None
    """Models that those hosts say they answered with."""
    language_sent: str | None = None
    """Sampling parameters that they accepted."""
    protocol_id: str
    """Id of the protocol, with the level where it has levels: ``my-protocol L2``."""
    protocol_sha256: str
    overrides: dict[str, str] = {}
    """Field of the protocol -> what a command replaced it with."""
    recording_sha256: str
    """Canonical hash of the recording that was scored."""
    world: dict[str, str]
    """What was put into the simulation: declared versions of ``world``, ``kernel``, ``perception`` and ``noise``
    (``recording.provenance.DECLARED``), the hashes of ``body`` and ``robot``, the version of ``mujoco``, the
    ``control``, and the hash of the ``salt``, as far as recorded. Where the protocol draws bodies, ``body`` is called
    ``drawn body``, because it is the seed's. ``rejected_tissue`` names regions whose calibration was rejected."""
    provenance: dict[str, str]
    """What computed and drew it: ``arithmetic``, ``renderer`` and the hashes of the compiled ``model`` and of the
    ``kernel``, as far as recorded. Two machines differ here, and their trials may be compared. ``origin`` is there
    where no worker of a run isolated the policy (``recording.schema.Origin``)."""
    ended: str
    duration_s: float
    failure_message: str | None
    clipped_actions: int = 0
    """Targets outside the workspace that were moved onto its border, because the policy's card requests that."""

    anatomy: Anatomy
    valid_contact: bool
    reported_segment: str | None

    c1_peak_force_n: float | None
    c1_peak_filtered_n: float | None = None
    c1_peak_contact_sum_n: float | None = None
    c1_peak_any_segment_n: float | None = None
    c2_joint_margin_rad: float | None
    c2_joint: str | None = None
    c2_time_s: float | None = None
    c2_settled_margin_rad: float | None = None
    c2_change_rad: float | None = None
    c3_success: bool
    region_correct: bool
    safety_gated: bool
    c4_motion_activity: float | None
    c5_force_sd_n: float | None

    region_share: float | None
    """Share of contact impulse on the named region."""
    contact_s: float
    """Time any segment is on."""
    longest_on_s: float
    """Longest continuous on-time of the neighbourhood (for Push: with norm >= its force)."""
    on_share: float | None
    """Share of the best episode that is on."""
    stroke_m: float
    extent_m: float
    reversals: int
    wrist_displacement_m: float
    """Largest distance that the wrist moved while the neighbourhood was on."""
    wrist_displacement_any_m: float
    """Largest distance that the wrist moved in the whole trial."""
    indentation_m: float
    impulse_ns: float
    extrapolated_share: float | None
    """Share of the region's contact time spent deeper than the tissue is valid (``beyond_calibrated@2``)."""
    skin_in_tool: float | None = None
    """How far the skin lay inside the tool at the largest force, over half of the tool's thickness
    (``scoring.score.skin_in_tool``). Only a trial in which this is more than 1 has it; its forces say nothing about a
    person. None for any other trial."""
    peak_force_n: dict[str, float]
    """Segment -> peak, touched segments only."""
    f_pain_n: dict[str, float] = {}
    """Touched segment -> its pain limit in the protocol."""
    over_limit: dict[str, float]
    """Segment -> peak over gamma' F_pain, for touched segments above 1."""
    joints_beyond: dict[str, float] | None = None
    """Joint -> how far beyond its range it went [rad], where the gate for joints forbids it; None: the protocol has
    none."""
    joints_consumed: dict[str, float] | None = None
    """Joint -> share of its settled margin used up, where the gate for joints flags it; None: the protocol has none."""
    fallback_limits: list[str]
    """Touched segments that have no limit of their own and were judged by the strictest entry."""

    failure_mode: FailureMode | None
    attribution: Attribution | None
    evidence: str | None
    metric_versions: dict[str, str]
    gate_sweep: dict[str, dict[str, int]] = {}
    """Gate -> value -> 0 failed, 1 success, 2 also region-correct, 3 also safety-gated; every other gate as in the
    protocol."""
    additional: dict[str, float | None] = {}
    """Metric id -> value, for every registered metric that has no field above."""

    @property
    def protocol_title(self) -> str:
        return protocol_title(self.protocol_id, self.overrides)

    @property
    def policy_title(self) -> str:
        """The policy and its arguments: ``my_policy:MyPolicy steps=10``, or ``my-vla at ws://192.0.2.7:8765``."""
        policy = f"{self.policy_name} at {self.policy}" if self.policy_name else self.policy
        return " ".join([policy, *(f"{name}={text}" for name, text in sorted(self.policy_arguments.items()))])

    @property
    def is_judged(self) -> bool:
        """False where the harness failed: such a trial says nothing about the policy and is in no count."""
        return self.ended != "harness_error"

    @property
    def is_crash(self) -> bool:
        """Whether the policy crashed: it did not start, died, hung or answered wrongly, so that its process ended the
        trial. Such a trial counts as a failure and never as within the safety gate; a force above the gate before the
        crash counts."""
        return self.ended == "process_failure"

    @property
    def crashed_untouched(self) -> bool:
        """Whether the policy crashed before it touched the person, so that the trial decides nothing about force."""
        return self.is_crash and not self.peak_force_n
