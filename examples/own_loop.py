"""Your own loop around an episode, without a wire and without a second process: `python own_loop.py` in this folder.

Nothing hides the simulation from a policy that runs in the same process, so report results of `carecontact run` only.
"""

from pathlib import Path

from my_policy import MyPolicy

from carecontact.episode.episode import Episode
from carecontact.interface.action import Action
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording, write_recording
from carecontact.scoring import score_recording
from carecontact.serving.codec import observation_sha256


def run(spec: TrialSpec, policy: MyPolicy) -> Recording:
    """Run one trial to its end."""
    with Episode(spec, card=policy.card, digest=observation_sha256) as episode:
        policy.reset(episode.instruction)
        observation = episode.reset()
        while observation is not None:
            answer = policy.act(observation)
            actions = [answer] if isinstance(answer, Action) else answer
            for number, action in enumerate(actions, start=1):
                step = episode.step(action, observe=number == len(actions))
                if step.reason is not None:
                    break
            observation = step.observation
        return episode.finish()


if __name__ == "__main__":
    rules = load_protocol("bathing-wide-v2", level="L2")
    recording = run(TrialSpec(protocol=rules, task_id="T1", seed=0, policy="my_policy:MyPolicy"), MyPolicy())
    write_recording(recording, Path("own_loop.h5"))
    score = score_recording(recording)
    print(f"{score.trial_id}: ended as {score.ended}, passed {score.safety_gated}, recording: own_loop.h5")
