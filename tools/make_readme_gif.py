"""Make the README's animation: a scrub on a forearm that gives way.

MUJOCO_GL=egl python tools/make_readme_gif.py docs/figures/scrub.gif

The state machine scrubs the forearm of bathing-v3 (T3, seed 0), with a stiffer arm and a path that lies deeper
than its own, so that the skin gives way visibly. The safety gate of the forearm is 35 N.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from carecontact.episode.episode import Episode
from carecontact.interface.action import Action
from carecontact.policies.state_machine import StateMachine
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording
from carecontact.replay.film import Film, write_gif
from carecontact.replay.views import Camera
from carecontact.scoring.contact import find_contact

STIFFNESS = (1000.0, 20.0)
DEEPER_M = 0.010
SIZE, FPS, COLOURS = (560, 350), 12.5, 96
LEAD_S, LENGTH_S = 0.6, 5.0
DISTANCE_M, SHADOWS_M = 0.34, 0.25


def deeper(action: Action) -> Action:
    pose = action.pose_tcp_in_base
    if pose is None:
        return replace(action, stiffness=STIFFNESS)
    return replace(action, pose_tcp_in_base=pose - np.array([0, 0, DEEPER_M, 0, 0, 0, 0]), stiffness=STIFFNESS)


def scrub() -> Recording:
    """The trial, in this process."""
    policy = StateMachine()
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T3", seed=0, policy="state-machine")
    with Episode(spec, card=policy.card) as episode:
        policy.reset(episode.instruction)
        for action in policy.act(episode.reset()):
            if episode.step(deeper(action), observe=False).reason is not None:
                break
        return episode.finish()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    recording = scrub()
    contact = find_contact(recording)
    touched_s = float(contact.time_s[contact.window][0])
    depth_mm = 1000 * recording["scorer/indentation_m"].max()
    header = recording.header
    print(f"protocol {header.spec.protocol.sha256[:12]}, tissue kernel {header.sha256['kernel'][:12]}")
    print(f"touched at {touched_s:.2f} s; at most {contact.force_in_window.max():.1f} N and {depth_mm:.1f} mm")
    film = Film(recording, fps=FPS, panel=False, size=SIZE)
    near = replace(film.view(0.0), distance_m=DISTANCE_M, radius_m=SHADOWS_M)
    film.view = Camera(view=near)
    begin_s = touched_s - LEAD_S
    write_gif(out, film.frames(begin_s, begin_s + LENGTH_S), fps=FPS, colours=COLOURS)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
