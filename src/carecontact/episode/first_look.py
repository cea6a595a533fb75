"""What a policy sees at t = 0, without running a trial."""

from __future__ import annotations

from pathlib import Path

from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode


def first_look(
    protocol: Protocol, *, task_id: str, seed: int, card: PolicyCard, weights: Path | None = None, salt: str = ""
) -> Observation:
    """Return the first observation of a trial, with the modalities and cameras of the card.

    Args:
        weights: folder with the weights of the protocol's segmenter.
        salt: the secret of a salted run.

    Raises:
        SceneError, SettleError, DependencyError: as a trial does.
    """
    spec = TrialSpec(protocol=protocol, task_id=task_id, seed=seed, policy=card.name, salt=salt)
    with Episode(spec, card=card, weights=weights) as episode:
        return episode.reset()
