"""The privileged way through a trial: a policy in the trial's own process that is given the episode's simulation."""

from __future__ import annotations

from carecontact.contract.policy_ref import PolicyRef
from carecontact.episode.episode import Episode
from carecontact.errors import ConfigError
from carecontact.oracle.policy import Oracle
from carecontact.policies.registry import is_privileged

PRIVILEGED = {"oracle": Oracle}
"""Every policy that is ever given a simulation: the classes of this package and no other, whatever a row says."""


def drive(episode: Episode, ref: PolicyRef) -> None:
    """Run a privileged policy to the end of the episode; its recording says ``privileged``.

    Raises ConfigError for a policy that is not one of PRIVILEGED.
    """
    if ref.text not in PRIVILEGED or not is_privileged(ref):
        raise ConfigError(f"policy {ref}: only {', '.join(PRIVILEGED)} may be given the simulation of a trial")
    made = PRIVILEGED[ref.text]
    episode.card, episode.privileged = made.card, True
    observation = episode.reset()
    policy = made(episode.simulation, episode.task, episode.session.action_bounds)
    while observation is not None:
        action = policy.act(observation)
        episode.answered(notes=policy.take_notes())
        observation = episode.step(action).observation
